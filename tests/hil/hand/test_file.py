"""The file of a hand: what each joint expands to, and what is said about a wrong file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.hand.file import is_hand, load, parse
from hil.stand.file import SIMULATED
from hil.stand.file import parse as parse_stand

HAND = """\
[hand]
name = "right hand"
backend = "dynamixel"
repeats = 3
cool_down = "1 min"

[dynamixel]
port = "/dev/ttyUSB0"
model = "xc330-t288"

[limits]
torque = "80 mN*m"
deflection = "60 deg"
velocity = 20.0

[[joint]]
name = "index_mcp"
dynamixel.id = 3
stand.gear_ratio = 1.6
limits.torque = "60 mN*m"
also_moves = {index_pip = 0.75}
routing_uncertainty = 0.02

[[joint]]
name = "index_pip"
[joint.dynamixel]
id = 4
[joint.stand]
name = "second of the index"

[[joint]]
name = "thumb"
dynamixel = {id = 5, baudrate = 57600}
"""


def said_about(text: str) -> list[str]:
    """Return the lines of the message about a wrong hand file, without its first line where it lists several."""
    with pytest.raises(WrongUse) as error:
        parse(text)
    first, *rest = str(error.value).splitlines()
    return [line.strip() for line in rest] or [first]


def test_a_joint_is_an_ordinary_stand_whose_own_keys_override_the_shared_ones(tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(HAND)
    hand = load(tmp_path / "hand.toml")
    assert (hand.name, hand.settings.repeats, hand.settings.cool_down, hand.settings.kind) == (
        "right hand", 3, 60.0, "chirp",
    )  # fmt: skip
    first, second, third = (joint.stand for joint in hand.joints)
    assert [stand.devices["dynamixel"].id for stand in (first, second, third)] == [3, 4, 5]
    assert [stand.devices["dynamixel"].baudrate for stand in (first, second, third)] == [1_000_000, 1_000_000, 57600]
    assert [stand.checked_limits().torque for stand in (first, second)] == pytest.approx([0.06, 0.08])
    assert first.checked_limits().deflection == pytest.approx(1.0472, rel=1e-4)
    assert (first.stand.gear_ratio, second.stand.gear_ratio) == (1.6, 1.0)
    assert (first.stand.name, second.stand.name) == ("right hand, index_mcp", "second of the index")
    assert (dict(hand.joints[0].also_moves), hand.joints[0].routing_uncertainty) == ({"index_pip": 0.75}, 0.02)
    assert (first.path, first.joint) == (tmp_path / "hand.toml", "index_mcp")
    again = parse_stand(first.text)  # what a recording keeps is read without the hand
    assert (again.stand, again.limits, again.devices) == (first.stand, first.limits, first.devices)
    with pytest.raises(WrongUse, match=r"unknown joint 'index_mpc': did you mean 'index_mcp'\?.*thumb"):
        hand.joint("index_mpc")


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("dynamixel.id = 3", "dynamixel.id = 300", 18, "joint index_mcp: dynamixel.id = 300: must be at most 252"),
        ("id = 4\n", "id = 400\n", 27, "joint index_pip: dynamixel.id = 400: must be at most 252"),
        ("{id = 5,", "{id = 500,", 33, "joint thumb: dynamixel.id = 500: must be at most 252"),
        ('"60 mN*m"', '"60 mV"', 20, "joint index_mcp: limits.torque: '60 mV'"),
        ('"60 mN*m"', "60", 20, "joint index_mcp: limits.torque: 60 would be 60 N m, "),
        ('"60 deg"', '"60 dag"', 13, "limits.deflection: '60 dag'"),  # shared: said once
        ("velocity = 20.0\n", "", 11, "limits.velocity: must be given"),
        ("xc330-t288", "xc330-t299", 9, "dynamixel.model = 'xc330-t299': must be"),
        ("stand.gear_ratio", "stand.gear_ration", 19, "joint index_mcp: stand.gear_ration: no such key; did you mean"),
        ("also_moves", "also_move", 21, "joint index_mcp: also_move: no such key; did you mean 'also_moves'?"),
        ("repeats = 3", "repeat = 3", 4, "hand.repeat: no such key; did you mean 'repeats'?"),
        ('backend = "dynamixel"', "backend = 3", 3, "hand.backend = 3: must be a text"),
        ("{index_pip = 0.75}", "{index_dip = 0.75}", 21, "also_moves: unknown joint 'index_dip': did you mean"),
        ("{index_pip = 0.75}", "{index_mcp = 0.75}", 21, "also_moves names the joint itself"),
        ("{index_pip = 0.75}", "{index_pip = 0}", 21, "index_pip = 0 moves nothing"),
        ("{index_pip = 0.75}", "{index_pip = nan}", 21, "must be a finite number"),
        ("routing_uncertainty = 0.02", "routing_uncertainty = -1", 22, "must be at least 0"),
        ('name = "thumb"', 'name = "index_pip"', 32, "two joints have the name 'index_pip'"),
        ('name = "thumb"\n', "", 31, "joint.2.name: must be given"),
        ("id = 4\n", "id = 3\n", 27, "joints index_mcp and index_pip both have dynamixel.id = 3"),
    ],
)
def test_an_error_has_the_line_and_the_key_of_the_hands_file(old: str, new: str, line: int, said: str) -> None:
    assert HAND.count(old) == 1
    (message,) = said_about(HAND.replace(old, new))
    assert message.startswith(f"line {line}: ")
    assert said in message


def test_a_routing_in_a_circle_is_refused_with_the_joints_of_the_circle() -> None:
    two = HAND.replace("[joint.dynamixel]", "also_moves = {thumb = 1}\n[joint.dynamixel]")
    assert parse(two).joints[1].also_moves == {"thumb": 1.0}  # a chain is a finger
    mutual = two.replace("thumb = 1", "index_mcp = 1")
    three = two.replace('name = "thumb"', 'name = "thumb"\nalso_moves = {index_mcp = -0.5}')
    assert "index_mcp moves index_pip, which moves index_mcp" in said_about(mutual)[0]
    assert "index_mcp moves index_pip, which moves thumb, which moves index_mcp" in said_about(three)[0]


def test_several_errors_are_listed_and_a_motor_on_another_port_is_another_motor() -> None:
    wrong = HAND.replace("dynamixel.id = 3", "dynamixel.id = 300").replace("velocity = 20.0", "velocity = -1")
    assert [line.split(":")[0] for line in said_about(wrong)] == ["line 14", "line 18"]
    assert len(parse(HAND.replace("id = 4\n", 'id = 3\nport = "/dev/ttyUSB1"\n')).joints) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# nothing yet\n", "hand.toml names no joint"),
        ("[hand]\n", "hand.toml names no joint"),
        ("joint = 3\n", "hand.toml names no joint"),
        (SIMULATED, "hand.toml is the stand file of one joint"),
        ('[campaign]\n[[joint]]\nname = "a"\n', "the plan of a campaign"),
        ("[hand\n", "is not TOML"),
    ],
)
def test_what_is_no_hand_is_refused_in_a_sentence(text: str, said: str) -> None:
    (message,) = said_about(text)
    assert said in message


def test_a_hand_in_the_place_of_a_stand_is_refused_with_its_joints() -> None:
    with pytest.raises(WrongUse, match="choose a joint with --joint NAME: index_mcp, index_pip, thumb"):
        parse_stand(HAND)
    assert is_hand(HAND)
    assert not any(map(is_hand, (SIMULATED, "", "[hand", '[campaign]\n[[joint]]\nname = "a"\n')))


def test_two_motors_pull_one_joint_which_both_name() -> None:
    pulls = '[[joint]]\nname = "{}"\nmoves = "mcp"\nalso_moves = {{pip = {}}}\n'
    text = '[hand]\nbackend = "sim"\n' + pulls.format("flexor", 0.7) + pulls.format("extensor", -0.5)
    hand = parse(text + '[[joint]]\nname = "pip"\n')
    assert [(joint.name, joint.moves) for joint in hand.joints] == [
        ("flexor", "mcp"),
        ("extensor", "mcp"),
        ("pip", "pip"),
    ]
    with pytest.raises(WrongUse, match=r"circle: pip moves mcp, which moves pip"):
        parse(text + '[[joint]]\nname = "pip"\nalso_moves = {mcp = 1}\n')
    with pytest.raises(WrongUse, match="unknown joint 'flexor'"):  # a motor's name is no joint here
        parse(text + '[[joint]]\nname = "pip"\nalso_moves = {flexor = 1}\n')
