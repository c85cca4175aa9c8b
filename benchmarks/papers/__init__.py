"""What the papers describe and no command takes: another body, other sizes of it."""
