"""Huang2024: path, dither and cut quality."""
