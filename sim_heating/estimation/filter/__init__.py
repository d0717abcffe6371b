"""The Kalman filter on the thermal step: innovations, process noise, smoother, unknown heating input."""
