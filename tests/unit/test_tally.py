import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.tally import UInt128

weights = st.integers(0, 2**59)


def exact(wide):
    return [int(h) * 2**64 + int(low) for h, low in zip(wide.high, wide.low, strict=True)]


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.tuples(weights, weights), min_size=1, max_size=8))
def test_squares_and_scatter_are_exact(rows):
    """Against Python's own unlimited integers."""
    values = np.array(rows, np.int64)
    squares = UInt128.zeros((2,))
    for row in values:
        squares.add_square(row)
    expected = [sum(int(x) ** 2 for x in column) for column in values.T]
    assert exact(squares) == expected

    total = values.sum(axis=0)
    scatter = squares.squared_deviations(total, len(rows))
    assert exact(scatter) == [len(rows) * q - int(t) ** 2 for q, t in zip(expected, total, strict=True)]
    np.testing.assert_allclose(scatter.floats(), [float(x) for x in exact(scatter)], rtol=1e-15)


@settings(deadline=None)  # the first call compiles
@given(weights, weights)
def test_addition_carries(a, b):
    one, two = UInt128.zeros((1,)), UInt128.zeros((1,))
    one.add_square(np.array([a]))
    two.add_square(np.array([b]))
    one.add(two)
    assert exact(one) == [a * a + b * b]
