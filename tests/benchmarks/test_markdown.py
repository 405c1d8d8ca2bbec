from benchmarks.markdown import replace_section, table

PAGE = "# Page\n\nTop.\n\n## A\n\nold a\n\n### deeper\n\nmore\n\n## B\n\nold b\n"


def test_a_section_replaces_the_one_of_the_same_title():
    assert replace_section(PAGE, "## A\n\nnew\n") == "# Page\n\nTop.\n\n## A\n\nnew\n\n## B\n\nold b\n"
    assert replace_section(PAGE, "## B\n\nnew\n") == PAGE.replace("old b", "new")


def test_a_new_section_is_appended_and_replacing_is_idempotent():
    once = replace_section(PAGE, "## A and more\n\nc\n")
    assert once == PAGE + "\n## A and more\n\nc\n"
    assert replace_section(once, "## A and more\n\nc\n") == once
    assert replace_section("", "## A\n\na\n") == "## A\n\na\n"


def test_a_table_has_header_rule_and_rows():
    assert table(("a", "b"), [("1", "2")]) == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]
