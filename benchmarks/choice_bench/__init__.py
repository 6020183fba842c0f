"""Scenes drawn anew for every task of the register, and the truth that its choices are held against."""
