"""Gestures: still hand and arm poses found in depth pictures by forests of depth tests that learn while the person
shows them. Source: Alcoverro 2014, chapter 3.

Files, formats of cameras and the screen are handled elsewhere. Depth is counted in whole millimetres here (uint16, 0 =
hole), the unit of the sensors, because the tests compare whole numbers; positions and areas that are returned are in
metres and cm^2.
"""
