"""The delay gate does not care what the worker's clock says, and cannot be lied to about age.

python examples/gate_and_clocks.py
"""

from dataclasses import replace

from drone_client.gate import GateSettings, ResultStamps, SentFrame, judge

MS = 1_000_000
HOUR = 3_600_000 * MS


def main() -> None:
    """Judge one honest result on three clocks, then two that should not pass."""
    gate = GateSettings(tau_max_ns=250 * MS, age_max_ns=400 * MS)
    sent = SentFrame(1, t_capture_ns=0, t1_ns=10 * MS, worker="edge-1", acknowledged_by=7)
    # 40 ms up, 30 ms on the worker, 20 ms down
    honest = ResultStamps(
        worker="edge-1",
        worker_boot_id=7,
        t_capture_ns=0,
        t1_ns=10 * MS,
        t2_ns=50 * MS,
        t3_ns=80 * MS,
        t4_ns=100 * MS,
    )
    for ahead_ns in (-HOUR, 0, HOUR):
        stamps = replace(honest, t2_ns=honest.t2_ns + ahead_ns, t3_ns=honest.t3_ns + ahead_ns)
        judgement = judge(stamps, sent, None, gate)
        print(
            f"worker {ahead_ns / HOUR:+.0f} h: {judgement.verdict}, d1+d2 = "
            f"{judgement.network_delay_ns / MS:.0f} ms, age = {judgement.age_ns / MS:.0f} ms"
        )

    slow = replace(honest, t4_ns=honest.t4_ns + 200 * MS)
    print(f"200 ms later on the way back: {judge(slow, sent, None, gate).verdict}")
    liar = replace(slow, t3_ns=slow.t3_ns + 200 * MS, t4_ns=slow.t4_ns + 150 * MS)
    print(f"and a worker that hides it in t3-t2: {judge(liar, sent, None, gate).verdict}")


if __name__ == "__main__":
    main()
