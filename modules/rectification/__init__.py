"""Rectification: raw images of a calibrated rig become a rectified pair, and chessboards become a calibration."""
