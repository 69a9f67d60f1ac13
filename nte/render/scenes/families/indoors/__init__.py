"""Families of furnished rooms and halls."""
