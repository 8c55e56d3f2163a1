from __future__ import annotations

import numpy as np
import pytest

from ga.models import UnknownTerm, parse

TIME = np.linspace(1.7e9, 1.7e9 + 4.0, 401)
DTHETA = 0.2 * np.sin(2.0 * (TIME - TIME[0]))
RATE = 0.4 * np.cos(2.0 * (TIME - TIME[0]))


def test_the_linear_model_is_equation_3() -> None:
    columns = parse("linear").columns(TIME, DTHETA, RATE)
    assert np.array_equal(columns, np.stack([DTHETA, RATE], axis=1))


def test_the_order_of_the_terms_does_not_matter() -> None:
    one, other = parse("coulomb + linear+offset"), parse("linear+offset+coulomb")
    assert one == other
    assert one.name == "linear+offset+coulomb"
    assert [p.name for p in one.parameters] == ["Kc", "Bc", "tau0", "Fc"]


def test_every_term_names_its_parameters_with_their_units_in_the_order_of_the_columns() -> None:
    model = parse("linear+offset+drift+coulomb+cubic")
    assert [(p.name, p.unit) for p in model.parameters] == [
        ("Kc", "N*m/rad"),
        ("Bc", "N*m*s/rad"),
        ("tau0", "N*m"),
        ("drift", "N*m/s"),
        ("Fc", "N*m"),
        ("K3", "N*m/rad^3"),
    ]
    columns = model.columns(TIME, DTHETA, RATE)
    assert columns.shape == (401, 6)
    assert np.array_equal(columns[:, 2], np.ones(401))
    assert np.array_equal(columns[:, 3], TIME - TIME[0])
    assert np.array_equal(columns[:, 5], DTHETA**3)


def test_coulomb_friction_is_a_sign_smoothed_where_the_joint_hardly_moves() -> None:
    friction = parse("linear+coulomb").columns(TIME, DTHETA, RATE)[:, 2]
    moving = np.abs(RATE) > 0.1
    assert friction[moving] == pytest.approx(np.sign(RATE[moving]), abs=1e-3)
    assert np.all(np.diff(friction[np.argsort(RATE)]) >= 0.0)


def test_the_smoothing_follows_the_scale_of_the_rate() -> None:
    model = parse("linear+coulomb")
    slow = model.columns(TIME, DTHETA, RATE * 1e-4)[:, 2]
    assert slow == pytest.approx(model.columns(TIME, DTHETA, RATE)[:, 2], rel=1e-9)


def test_a_joint_that_never_moved_has_no_coulomb_column() -> None:
    columns = parse("linear+coulomb").columns(TIME, DTHETA, np.zeros(401))
    assert not columns[:, 2].any()


def test_an_unknown_term_is_answered_with_the_known_ones_and_the_nearest() -> None:
    with pytest.raises(UnknownTerm, match=r'no model term "coulom"; .*linear, offset.* did you mean "coulomb"\?'):
        parse("linear+coulom")


@pytest.mark.parametrize("term", ["backlash", "slack", "skew", "inertia"])
def test_a_term_that_is_not_linear_is_said_to_be_unavailable(term: str) -> None:
    with pytest.raises(UnknownTerm, match=f'"{term}" is not available yet'):
        parse(f"linear+{term}")


def test_a_term_named_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="offset is named twice"):
        parse("linear+offset+offset")


def test_a_model_without_stiffness_and_damping_is_refused() -> None:
    with pytest.raises(ValueError, match="begins with linear"):
        parse("offset")


def test_vectors_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="differ in shape"):
        parse("linear").columns(TIME, DTHETA[:-1], RATE)


def test_an_anchored_model_is_one_model_for_every_part_of_the_data() -> None:
    model = parse("linear+drift+coulomb")
    whole = model.columns(TIME, DTHETA, RATE)
    anchored = model.anchored(TIME, RATE)
    parts = [anchored.columns(TIME[part], DTHETA[part], RATE[part]) for part in (slice(0, 90), slice(90, None))]
    assert np.array_equal(np.concatenate(parts), whole)
    assert not np.array_equal(model.columns(TIME[90:], DTHETA[90:], RATE[90:]), whole[90:])
