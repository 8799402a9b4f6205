"""What a run leaves on disk: its folder, record and log, the ledger and the reference."""
