"""Pictures: background to mask, rendering, visibility."""
