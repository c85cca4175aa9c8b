"""Many recordings times many settings."""
