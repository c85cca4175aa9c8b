"""Pictures and sound of videos and folders."""
