"""What tests need beside Python packages: packages of the system, each looked for once and named as Debian names it.

`@pytest.mark.needs("netcdf-bin")` skips a test where the package is missing; nothing else is ever skipped.
"""

import functools
import shutil

import pytest

from gonio.plots import style

pytest.register_assert_rewrite("height_field_laws", "statistical", "transport_laws")


def _mitsuba_loads():
    try:
        import mitsuba  # noqa: F401
    except (ImportError, NameError):  # it trips over a name of its own where a library of the system is missing
        return False
    return True


FOUND = {
    "chromium-driver": lambda: bool(shutil.which("chromium") and shutil.which("chromedriver")),
    "libatomic1": _mitsuba_loads,
    "libegl1": style.can_render,
    "libgl1-mesa-dri": style.can_render,
    "netcdf-bin": lambda: bool(shutil.which("ncdump")),
}
"""How each package is looked for: by what tests do with it."""


@functools.cache
def found(package):
    return FOUND[package]()


def pytest_addoption(parser):
    group = parser.getgroup("gonio")
    group.addoption("--no-skips", action="store_true", help="fail where a package of the system is missing")
    group.addoption("--bare", action="store_true", help="as if no package of the system were there")


def pytest_runtest_setup(item):
    packages = [package for mark in item.iter_markers("needs") for package in mark.args]
    bare, no_skips = item.config.getoption("bare"), item.config.getoption("no_skips")
    if missing := [package for package in packages if bare or not found(package)]:
        reason = f"needs Debian's {' and '.join(missing)}"
        if no_skips:
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Nothing is skipped for other reasons either, where nothing may be."""
    report = yield
    if report.skipped and item.config.getoption("no_skips"):
        report.outcome = "failed"
    return report
