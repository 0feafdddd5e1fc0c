"""The table of own captures: what is accepted, and that every fault names its line."""

import copy

import pytest
import yaml

from zeroshop_steps import methods
from zeroshop_steps.runtime.config_files import config_changes, name_error, read_objects, to_config_word
from zeroshop_steps.runtime.errors import StepError

HEADER = "dataset\tobject\timages\tmasks\theight_m"
SCHEMA = "workflow/schemas/objects.schema.yaml"


@pytest.fixture
def read(tmp_path, pytestconfig):
    """Read a table with the given text."""

    def read_text(text):
        (tmp_path / "objects.tsv").write_text(text)
        return read_objects(tmp_path / "objects.tsv", pytestconfig.rootpath / SCHEMA, methods.HEIGHTS)

    return read_text


def test_rows_by_dataset_and_object(read):
    rows = read(
        f"# my captures\n{HEADER}\n\nphotos\tcup\tcup/images\tcup/masks\t0.095\nphotos\tbox\tbox/images\tbox/masks\nown\tcup\ta b\tc\t\n"
    )
    assert list(rows) == [("photos", "cup"), ("photos", "box"), ("own", "cup")]
    assert rows["photos", "cup"]["height_m"] == 0.095
    assert rows["photos", "box"]["height_m"] is None
    assert rows["own", "cup"]["images"] == "a b"


def test_columns_that_may_be_missing_are_empty(read):
    [row] = read(f"{HEADER}\nphotos\tcup\ta\tb\t\n").values()
    assert (row["height_method"], row["marker_images"], row["depth"]) == ("", "", "")
    [row] = read(f"{HEADER}\theight_method\tmarker_images\nphotos\tcup\ta\tb\t\tmarker\tempty table\n").values()
    assert (row["height_method"], row["marker_images"], row["depth"], row["picture_count"]) == ("marker", "empty table", "", None)


def test_a_number_of_pictures_is_a_whole_one(read):
    [row] = read(f"{HEADER}\tpicture_count\nphotos\tcup\ta\tb\t\t60\n").values()
    assert row["picture_count"] == 60 and isinstance(row["picture_count"], int)
    for text in ("7", "60.5", "many"):
        with pytest.raises(StepError, match="line 2: picture_count"):
            read(f"{HEADER}\tpicture_count\nphotos\tcup\ta\tb\t\t{text}\n")


def test_a_header_alone_is_an_empty_table(read):
    assert read(HEADER + "\n") == {}


def test_windows_line_ends_and_byte_order_mark(read):
    assert list(read("\ufeff" + HEADER + "\r\nphotos\tcup\ta\tb\t0.1\r\n")) == [("photos", "cup")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("dataset\tobject\timages\theight_m\nphotos\tcup\ta\t0.1\n", "lacks the column masks"),
        (HEADER + "\tcolour\n", "unknown column: colour"),
        (f"{HEADER}\theight_method\nphotos\tcup\ta\tb\t0.1\tguess\n", "line 2: height_method: 'guess' is not one of"),
        (HEADER + "\timages\n", "the column images is there twice"),
        (HEADER.replace("\t", "  ") + "\n", "lacks the column dataset, object"),
        (f"{HEADER}\nphotos\tcup\ta\tb\t-0.1\n", "line 2: height_m: -0.1 is less than"),
        (f"{HEADER}\nphotos\tcup\ta\tb\t120\n", "line 2: height_m: 120.0 is greater than the maximum of 3"),
        (f"{HEADER}\nphotos\tcup\ta\tb\tnan\n", "line 2: height_m"),
        (f"{HEADER}\nphotos\tcup\ta\tb\ttall\n", "line 2: height_m: 'tall' is not of type"),
        (f"{HEADER}\nphotos\tmy cup\ta\tb\t0.1\n", "line 2: object: 'my cup' does not match"),
        (f"{HEADER}\nphotos\t../cup\ta\tb\t0.1\n", "line 2: object: '../cup' does not match"),
        (f"{HEADER}\nphotos\tcup\t\tb\t0.1\n", "line 2: images"),
        (f"{HEADER}\nphotos\tcup\ta\tb\t0.1\textra\n", "line 2: 6 cells, but the header names 5"),
        (f'{HEADER}\nphotos\tcup\ta\tb\t0.1\nphotos\tmug\t"a\tb\t0.1\n', "line 3: a quotation mark without its other half"),
        (f'{HEADER}\nphotos\tmug\t"a" b\tb\t0.1\n', "line 2: a quotation mark without its other half"),
        (f"{HEADER}\nphotos\tcup\ta\tb\t0.1\n\nphotos\tcup\tc\td\t0.2\n", "line 4: photos cup is there twice"),
    ],
)
def test_faults_name_table_and_line(read, text, message):
    with pytest.raises(StepError) as error:
        read(text)
    assert message in str(error.value)
    assert "objects.tsv" in str(error.value)


def test_an_unknown_name_shows_near_matches():
    assert name_error("scene", "su-h", ["su_l", "su_h"]) == "unknown scene: su-h. Did you mean su_h? Known: su_l, su_h."
    assert name_error("scene", "zzz", []) == "unknown scene: zzz. Known: none."


def test_what_a_config_changes_can_be_given_again(pytestconfig):
    path = pytestconfig.rootpath / "config" / "config.yaml"
    config = yaml.safe_load(path.read_text())
    assert config_changes(config, path) == []
    config["datasets"]["ycbv"]["models_folder"] = "my models/ycbv"
    config["nvs"]["2dgs"]["train"]["iterations"] = 30
    config["targets"] = []
    changes = config_changes(copy.deepcopy(config), path, ignored=["targets"])
    given = {key: yaml.safe_load(value) for key, value in (change.split("=", 1) for change in changes)}
    assert given == {"datasets": {"ycbv": {"models_folder": "my models/ycbv"}}, "nvs": {"2dgs": {"train": {"iterations": 30}}}}


@pytest.mark.parametrize(
    "value",
    ["/home/me/results/objects.tsv", "/s p/ü #1 'q'/objects.tsv", 'a "b".tsv', "'a: b'", "{x}.tsv", {"saliency": {"network": "/a #1/b"}}],
)
def test_snakemake_reads_words_of_the_config_as_they_were(value):
    from snakemake.cli import parse_config

    assert parse_config([to_config_word("some_key", value)]) == {"some_key": value}
