import numpy as np

from twinbench import Estimator, gaussian_state, no_info, register


@register
class Regression(Estimator):
    name, says = "regression", "ordinary least squares on the present readings"

    def fit(self, train, validation, seed):
        X, Y = train.measured[:, ::40].reshape(-1, 7), train.truth.estimated[:, ::40].reshape(-1, 10)
        x, y = np.nanmean(X, axis=0), Y.mean(axis=0)
        W = np.linalg.lstsq(np.nan_to_num(X - x), Y - y, rcond=None)[0]
        self.arrays = {"x": x, "y": y, "W": W, "cov": np.cov((Y - y - np.nan_to_num(X - x) @ W).T)}

    def init(self, batch):
        return gaussian_state(np.tile(self.arrays["y"], (batch, 1)), self.arrays["cov"])

    def step(self, state, sample):
        mean = self.arrays["y"] + np.nan_to_num(sample.measured - self.arrays["x"]) @ self.arrays["W"]
        return gaussian_state(mean, self.arrays["cov"]), no_info(len(mean))
