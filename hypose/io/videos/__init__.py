"""Reading and writing of videos, folders of pictures and sound; access to cameras."""
