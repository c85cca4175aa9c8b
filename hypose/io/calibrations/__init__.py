"""Reading and writing of calibration files of many programs."""
