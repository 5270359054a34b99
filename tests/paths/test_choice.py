"""Rules for layers and colours: which names are cut, engraved or ignored."""

import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import colours
from kerfgym.envs.paths.choice import Choice, merged

THERE = ("OUTLINE", "Holes", "DIM_1", "DIM_2", "Text")


def roles(rules):
    choice = Choice("layer", rules)
    return "".join(choice.role(name)[0] for name in THERE)


@pytest.mark.parametrize(
    ("rules", "expected"),
    [
        (None, "ccccc"),
        ("outline", "ciiii"),
        ("OUTLINE,holes", "cciii"),
        (["cut=OUTLINE", "cut=Holes"], "cciii"),
        ("ignore=DIM*", "cciic"),
        ("engrave=text", "cccce"),
        (["ignore=DIM_?", "engrave=TEXT,DIM_1"], "cciie"),
        (["cut=*", "ignore=Text"], "cccci"),
        (["cut=OUTLINE", "engrave=Text"], "ciiie"),
    ],
)
def test_rules_that_cut_leave_the_rest_out_and_others_do_not(rules, expected):
    assert roles(rules) == expected


def test_a_rule_for_nothing_that_is_there_is_refused_with_the_nearest():
    with pytest.raises(InvalidInput, match=r"part: no layer 'Hole'; did you mean 'Holes'\? \(known: OUTLINE, Holes, "):
        Choice("layer", "ignore=Hole").check("part", THERE)
    with pytest.raises(InvalidInput, match=r"no layer 'X\*'"):
        Choice("layer", "X*").check("part", THERE)
    with pytest.raises(InvalidInput, match=r"known: layer0, .* and 60 more\)"):
        Choice("layer", "nothing").check("part", [f"layer{i}" for i in range(100)])
    Choice("layer", ["ignore=DIM*", "holes"]).check("part", THERE)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ([], "layers is empty"),
        ("", "a rule names no layer"),
        ("cut=", "a rule names no layer"),
        ("ingore=DIM", r"'ingore=DIM' begins with no known role; did you mean 'ignore'\?"),
    ],
)
def test_a_rule_that_says_nothing_is_refused(rules, message):
    with pytest.raises(InvalidInput, match=message):
        Choice("layer", rules)


def test_where_rules_disagree_the_more_careful_one_holds():
    assert merged("cut", "ignore") == merged("ignore", "engrave") == "ignore"
    assert merged("engrave", "cut") == "engrave"
    assert merged("cut", "cut") == "cut"


@pytest.mark.parametrize(
    ("name", "expected"),
    [("1", "#ff0000"), ("red", "#ff0000"), ("Green", "#00ff00"), ("black", "#ffffff"), ("#0af", "#00aaff")],
)
def test_cad_colours_have_numbers_and_names(name, expected):
    assert colours.in_dxf(name) == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [("green", "#008000"), ("rgb(255, 0, 0)", "#ff0000"), ("none", "none"), ("#123456", "#123456")],
)
def test_strokes_have_the_colours_of_css(name, expected):
    assert colours.in_svg(name) == expected


@pytest.mark.parametrize("name", ["0", "256", "reddish", "url(#a)"])
def test_what_is_no_colour_is_refused(name):
    with pytest.raises(ValueError, match="not a colour"):
        colours.in_dxf(name)
