"""Small kernels."""

import numpy as np

from msal_cli.kernels.library import compiled

FACTOR = 3.0
TABLE = np.array([2, 5], dtype=np.int64)


@compiled
def scaled(values, result):
    for i in range(len(values)):
        result[i] = FACTOR * values[i]


@compiled
def scaled_sum(values, scratch):
    scaled(values, scratch)
    total = 0.0
    for i in range(len(scratch)):
        total += scratch[i]
    return total


@compiled
def described(values, number, is_odd):
    return len(values), number * 0.5, is_odd or TABLE[1] == number, values.shape[1]


@compiled
def column_sum(values):
    total = 0
    for i in range(values.shape[0]):
        total += values[i]
    return total


@compiled
def room(size):
    return len(np.empty(size))


@compiled
def functions(value, power):
    return np.arctan2(value, 2.0), value**power, np.log10(value), np.exp(value), np.sin(value)
