"""The studio: a local web page and its server, to view results, click joints, teach gestures and set up recordings.

Sources of the page are in web/, its build goes to static/ here (docs/studio-protocol.md describes the protocol).
"""
