"""Gestures: still hand and arm poses found in depth pictures by forests of depth tests that learn while you watch.

Alcoverro 2014, chapter 3. Values and functions only; files, cameras' own formats and the screen are elsewhere. Unlike
the rest of the product this room counts depth in whole millimetres (uint16, 0 = hole), the sensors' own unit, because
the tests compare whole numbers; positions and areas that leave it are in metres.
"""
