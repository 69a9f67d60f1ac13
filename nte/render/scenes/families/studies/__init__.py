"""Families on a small stage, each for one effect that denoisers are judged on."""
