"""Procedural scenes: what they are built from, and families/ of them."""
