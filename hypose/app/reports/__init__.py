"""Draw results for users: overlays, charts, pages."""
