"""The templates of html pages, and the script that lets their tables be sorted and filtered."""

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

HOME = "kinebench_drake.report"


def environment(package: str = HOME) -> Environment:
    """Templates of a package, then those that all pages share; what is put into them is escaped."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, "."), PackageLoader(HOME, ".")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
