"""The estimators that the proposed method is compared with."""
