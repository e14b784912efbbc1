"""The graph in Foxglove and Lichtblick: every topic unchanged, over their WebSocket protocol.

One node subscribes to all topics, as the recorder does, and forwards the bytes with the schemas that the
recorder writes. A layout for the live graph therefore also fits a recorded session.
"""
