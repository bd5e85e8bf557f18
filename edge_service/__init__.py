"""The edge service: transport -> mailbox -> decode -> detect -> localise -> reply."""
