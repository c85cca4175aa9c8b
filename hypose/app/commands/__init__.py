"""The commands as they are typed: options in, one sentence or a job out."""
