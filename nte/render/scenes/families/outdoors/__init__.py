"""Families under an open sky."""
