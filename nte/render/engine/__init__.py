"""Mitsuba and Dr.Jit: the variant, arrays, random numbers, camera rays, and the stages that hold a scene."""
