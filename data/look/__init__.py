"""What a recording holds, before anybody has a simulator or an estimator."""
