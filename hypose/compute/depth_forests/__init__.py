"""Forests of depth tests, and the sensor that makes their pictures."""
