"""Texts of message definitions as they are compared."""

from __future__ import annotations


def bare(text: str) -> str:
    """Without comments and blank lines: releases of ROS 2 comment on their own types in other words."""
    lines = (line.split("#")[0].strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line)
