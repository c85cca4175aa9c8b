"""What people look at: overlays, plots, pages."""
