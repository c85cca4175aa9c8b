"""Reading and writing of motions, bodies and results."""
