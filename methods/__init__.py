"""What every estimator uses: the protocol, filters, front end, noise; and in its own room DeepONet-Kalman."""
