"""The studio: a local web page to see results, click joints, teach gestures and set recordings up, and its server.

The page's sources are in web/, its build lands in static/ here (docs/studio-protocol.md says what they exchange).
"""
