"""Bursts of photographs: read, aligned and merged into one with less noise."""
