"""Drives on joints, and links made of beams."""
