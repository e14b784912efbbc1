"""A judged session as a document to hand around: one HTML file, and its pictures."""
