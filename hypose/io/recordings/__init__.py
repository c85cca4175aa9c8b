"""Recordings on disk: settings, frames, projects of others."""
