"""A bad link on one machine: delay, jitter, burst loss, rate, queue, partition, for any protocol."""
