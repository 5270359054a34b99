"""Columns of a block, and the functions and random numbers that vectorise."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from kerfgym.envs.engine import lanes
from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.engine.lanes import W, bits, gauss, load, logarithm, mix, sine, store, uniform


class Inner(NamedTuple):
    """A part of a part."""

    a: float = 1.5
    flag: bool = True


class Outer(NamedTuple):
    """Numbers, flags and a part between them."""

    x: float = -2.0
    inner: Inner = Inner()
    on: bool = False
    y: float = 7.25


def _copied(block, source, target):
    store(block, target, load(Outer, block, source))


def _changed(block, at):
    p = load(Outer, block, at)
    inner = Inner(p.inner.a * 2.0, not p.inner.flag)
    store(block, at, Outer(p.x + p.y, inner, p.inner.flag and not p.on, p.inner.a if p.on else -p.inner.a))


def _sines(x, out):
    for i in range(x.size):
        out[i] = sine(x[i])


def _logarithms(x, out):
    for i in range(x.size):
        out[i] = logarithm(x[i])


def _words(key, out):
    for i in range(out.size):
        out[i] = bits(key, np.uint64(i))


def _uniforms(key, out):
    for i in range(out.size):
        out[i] = uniform(bits(key, np.uint64(i)))


def _gausses(key, out):
    for i in range(out.size):
        n = np.uint64(i) * np.uint64(2)
        out[i] = gauss(bits(key, n), uniform(bits(key, n + np.uint64(1))))


copied, changed, sines, logarithms, words, uniforms, gausses = (
    for_python(f) for f in (_copied, _changed, _sines, _logarithms, _words, _uniforms, _gausses)
)


def column_of(block: np.ndarray, lane: int) -> np.ndarray:
    return block.reshape(-1, W)[:, lane]


# ---------------------------------------------------------------------------------------------- parts in a column


def test_a_part_lies_in_consecutive_rows_of_its_lane_in_the_order_of_its_fields():
    assert lanes.fields(Outer) == ["x", "inner.a", "inner.flag", "on", "y"]
    assert lanes.rows(Outer) == 5
    value = Outer(3.0, Inner(-4.5, False), True, 0.125)
    assert lanes.flat(value) == [3.0, -4.5, 0.0, 1.0, 0.125]
    back = lanes.unflat(Outer, lanes.flat(value))
    assert back == value
    assert isinstance(back.on, bool)
    assert isinstance(back.inner, Inner)


@pytest.mark.parametrize(("flag", "on"), [(False, False), (False, True), (True, False), (True, True)])
def test_compiled_code_moves_a_nested_part_between_columns_and_touches_nothing_else(flag, on):
    rng = np.random.default_rng(3)
    block = rng.normal(size=12 * W)
    value = Outer(rng.normal(), Inner(rng.normal(), flag), on, rng.normal())
    column_of(block, 5)[2:7] = lanes.flat(value)
    expected = block.copy()
    column_of(expected, 31)[6:11] = lanes.flat(value)
    copied(block, np.uint64(2 * W + 5), np.uint64(6 * W + 31))
    assert np.array_equal(block, expected)


@pytest.mark.parametrize("number", [1.0, -1.0, 0.5, 1e-300])
def test_any_number_but_zero_is_true_and_is_written_back_as_one(number):
    block = np.zeros(5 * W)
    column_of(block, 0)[:] = [1.0, 2.0, number, 0.0, 3.0]
    copied(block, np.uint64(0), np.uint64(0))
    assert column_of(block, 0).tolist() == [1.0, 2.0, 1.0, 0.0, 3.0]


def test_flags_and_numbers_of_a_part_can_be_computed_with():
    block = np.zeros(5 * W)
    column_of(block, 17)[:] = lanes.flat(Outer(1.0, Inner(4.0, True), False, 10.0))
    changed(block, np.uint64(17))
    assert lanes.unflat(Outer, column_of(block, 17)) == Outer(11.0, Inner(8.0, False), True, -4.0)


def test_a_layout_hands_out_rows_one_behind_the_other():
    layout = lanes.Layout()
    assert [int(layout.place(n)) for n in (3, 1, 4)] == [0, 3 * W, 4 * W]
    assert layout.rows == 8


# ------------------------------------------------------------------------------------------------------ functions


def test_sine_is_right_to_2e_9_up_to_1e5():
    rng = np.random.default_rng(1)
    spread = rng.uniform(-1.0, 1.0, 300_000) * 10.0 ** rng.uniform(-6.0, 5.0, 300_000)
    near_zeros = np.pi * rng.integers(-31_830, 31_830, 100_000) + rng.normal(0.0, 1e-3, 100_000)
    x = np.concatenate([spread, near_zeros, np.linspace(-10.0, 10.0, 100_001), [0.0, 99_999.9, -99_999.9]])
    out = np.empty_like(x)
    sines(x, out)
    assert np.abs(out - np.sin(x)).max() < 2e-9


def test_sine_is_odd_and_exactly_zero_at_zero():
    x = np.linspace(0.0, 50.0, 10_001)
    plus, minus = np.empty_like(x), np.empty_like(x)
    sines(x, plus)
    sines(-x, minus)
    assert plus[0] == 0.0
    assert np.abs(plus + minus).max() < 1e-12


def test_logarithm_is_right_to_1e_10_over_all_normal_numbers():
    rng = np.random.default_rng(2)
    wide = 10.0 ** rng.uniform(-307.0, 308.0, 300_000)
    near_one = 1.0 + rng.normal(0.0, 0.3, 100_000).clip(-0.9)
    powers = 2.0 ** np.arange(-1022.0, 1024.0)
    roots = np.sqrt(2.0) * 2.0 ** np.arange(-20.0, 20.0)  # where the mantissa is split
    x = np.concatenate([wide, near_one, powers, roots, np.nextafter(roots, 0.0), np.nextafter(roots, 1e9)])
    out = np.empty_like(x)
    logarithms(x, out)
    assert np.abs(out - np.log(x)).max() < 1e-10


# -------------------------------------------------------------------------------------------------- random numbers


def drawn(kernel_, key: int, n: int, dtype=np.float64) -> np.ndarray:
    out = np.empty(n, dtype)
    kernel_(np.uint64(key), out)
    return out


def test_words_of_stream_zero_are_those_of_splitmix64():
    # Steele et al. 2014, computed with Python's whole numbers.
    mask = 2**64 - 1

    def word(state: int) -> int:
        z = state & mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        return z ^ (z >> 31)

    key = 1234567
    expected = [word(key + n * 0x9E3779B97F4A7C15) for n in range(100)]
    assert drawn(words, key, 100, np.uint64).tolist() == expected
    assert expected[1] == 6457827717110365317  # first number of the reference implementation seeded with 1234567


@pytest.mark.parametrize("key", [0, 1, 2**63, 987654321])
def test_uniform_numbers_are_uniform(key):
    x = drawn(uniforms, key, 200_000)
    assert x.min() >= 0.0
    assert x.max() < 1.0
    assert stats.kstest(x, "uniform").pvalue > 1e-3


def test_gauss_has_the_moments_of_its_construction():
    n = 4_000_000
    x = drawn(gausses, 77, n)
    # A binomial count of 64 bits and a uniform number: fourth cumulant −8 − 1/120, variance 16 + 1/12.
    kurtosis = 3.0 - (8.0 + 1.0 / 120.0) / (16.0 + 1.0 / 12.0) ** 2
    assert abs(x.mean()) < 4.0 / np.sqrt(n)
    assert abs(x.var() - 1.0) < 4.0 * np.sqrt((kurtosis - 1.0) / n)
    assert abs(stats.skew(x)) < 4.0 * np.sqrt(6.0 / n)
    assert abs(stats.kurtosis(x, fisher=False) - kurtosis) < 4.0 * np.sqrt(24.0 / n)
    assert np.abs(x).max() < 8.2


def test_gauss_is_a_binomial_count_filled_linearly_and_so_close_to_normal():
    scale = 1.0 / np.sqrt(16.0 + 1.0 / 12.0)
    edges = (np.arange(66) - 32.5) * scale
    shares = np.concatenate([[0.0], stats.binom.cdf(np.arange(65), 64, 0.5)])
    x = drawn(gausses, 78, 1_000_000)
    assert stats.kstest(x, lambda at: np.interp(at, edges, shares)).pvalue > 1e-3
    for sigma in (1.0, 2.0, 3.0):
        assert np.mean(np.abs(x) > sigma) == pytest.approx(2.0 * stats.norm.sf(sigma), rel=0.1)


def test_streams_of_different_keys_are_uncorrelated_with_each_other_and_with_themselves_later():
    n = 20_000
    keys = mix(5, np.arange(32))
    x = np.stack([drawn(gausses, key, n) for key in keys])
    r = np.corrcoef(x)[np.triu_indices(len(keys), 1)]
    assert np.abs(r).max() < 5.0 / np.sqrt(n)
    assert np.std(r) == pytest.approx(1.0 / np.sqrt(n), rel=0.15)
    for lag in (1, 2, 6, 32):
        assert np.abs((x[:, :-lag] * x[:, lag:]).mean(axis=1)).max() < 4.5 / np.sqrt(n)


# ------------------------------------------------------------------------------------------------------------ keys


def test_each_input_bit_of_mix_flips_half_of_the_output_bits():
    rng = np.random.default_rng(4)
    first, second = (rng.integers(0, 2**63, 4000, dtype=np.uint64) for _ in range(2))
    base = mix(first, second)
    for bit in range(64):
        flip = np.uint64(1) << np.uint64(bit)
        for other in (mix(first ^ flip, second), mix(first, second ^ flip)):
            flipped = base ^ other
            assert np.bitwise_count(flipped).mean() == pytest.approx(32.0, abs=5 * 4.0 / np.sqrt(4000))
            per_bit = [((flipped >> np.uint64(out)) & np.uint64(1)).mean() for out in range(0, 64, 7)]
            assert np.allclose(per_bit, 0.5, atol=5.0 * 0.5 / np.sqrt(4000))


def test_keys_over_a_grid_of_seeds_episodes_and_parts_never_collide():
    seeds, episodes, machines = np.meshgrid(np.arange(50), np.arange(100), np.arange(200), indexing="ij")
    keys = mix(seeds, episodes, machines)
    assert keys.shape == (50, 100, 200)
    assert np.unique(keys).size == keys.size


def test_the_order_and_number_of_arguments_of_mix_matter():
    assert mix(1, 2) != mix(2, 1)
    assert mix(1) != mix(1, 0)
    assert mix(0) != mix(0, 0)
    assert mix(-1) != mix(1)
    assert mix(3, 4) == mix(np.array(3), 4)


class More(NamedTuple):
    """What is known beside."""

    far: bool = True
    z: float = 9.0


def test_an_extended_part_has_the_fields_of_both_and_its_own_defaults():
    whole = lanes.extended("Whole", Outer, More, x=4.0)
    assert whole._fields == Outer._fields + More._fields
    assert tuple(whole()) == (4.0, *tuple(Outer())[1:], *More())
    assert lanes.fields(whole) == lanes.fields(Outer) + lanes.fields(More)
    assert lanes.row(whole, "inner.flag") == 2 * W
    block = np.zeros(lanes.rows(whole) * W)
    store(block, 3, whole(y=-1.0, far=False))
    assert load(whole, block, 3) == whole(y=-1.0, far=False)
