"""Figures of everything shipped, recorded, so that none of them changes unnoticed."""
