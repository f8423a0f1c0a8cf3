"""What each command can be asked for: its options, pure descriptions."""
