"""Kills: commands that are killed at a random moment, and what the same command makes of it afterwards."""
