"""Procedural scenes: the parts that they are built from, and `families` of them."""
