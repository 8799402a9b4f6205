"""What a run leaves on disk: its folder, record, log, ledger and the reference, each in one form."""
