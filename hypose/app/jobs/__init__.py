"""What a command does once its options are known, from files to files."""
