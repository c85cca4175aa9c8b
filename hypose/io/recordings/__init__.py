"""Reading of recordings: settings, views, frames of evidence, and projects of other programs."""
