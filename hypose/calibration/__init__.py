"""Camera calibration: from boards and measured points, its examination, and its refinement from the moving person."""
