"""Accuracy against time: every rung of every stage on fixed simulated scenes, compared with a plain OpenCV
baseline.
"""
