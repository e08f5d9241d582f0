"""The proposed method: an operator network inside an augmented Kalman filter."""
