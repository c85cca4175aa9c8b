"""Calibration files of every family."""
