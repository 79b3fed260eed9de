"""Compile rp2040py for this Python alone: it is three times as fast as the installed one.

Usage: compile_emulator.py OUTPUT. The libraries in its wheel fit every Python, which makes every
call slower; the wheel also has their C sources. The model of the flash cache (xip_cache.pyx) uses
their declarations and is compiled with them. Without a C compiler nothing changes. The header of
a test run says which of the two runs.
"""

import shlex
import shutil
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

_PACKAGE = "rp2040py"
_CACHE = Path(__file__).with_name("xip_cache.pyx")


def _compile(source: Path) -> None:
    """Compile a module to a library in its folder. Raise OSError or CalledProcessError."""
    options = ("LDSHARED", "CFLAGS", "CCSHARED")
    command = [word for name in options for word in shlex.split(sysconfig.get_config_var(name))]
    library = source.with_suffix(sysconfig.get_config_var("EXT_SUFFIX"))
    include = f"-I{sysconfig.get_path('include')}"
    subprocess.run(
        [*command, "-O3", "-g0", "-w", include, str(source), "-o", str(library)], check=True
    )


def _translate(output: Path) -> Path:
    """Translate the model of the cache to C. Raise CalledProcessError."""
    source = output / _CACHE.with_suffix(".c").name
    command = [sys.executable, "-m", "cython", "-I", str(output), str(_CACHE), "-o", str(source)]
    subprocess.run(command, check=True)
    return source


def main(output: Path) -> None:
    """Copy the package and compile it with the cache; leave no copy if that fails."""
    copy = output / _PACKAGE
    shutil.rmtree(copy, ignore_errors=True)
    output.mkdir(parents=True, exist_ok=True)
    for made in output.glob(f"{_CACHE.stem}.*"):
        made.unlink()
    found = find_spec(_PACKAGE)
    if found is None or found.origin is None or sysconfig.get_config_var("LDSHARED") is None:
        print("the emulator is not compiled: no rp2040py, or no word on how Python was compiled")
        return
    shutil.copytree(Path(found.origin).parent, copy)
    for library in copy.glob("native/*.abi3.so"):
        library.unlink()
    try:
        with ThreadPoolExecutor() as pool:
            list(pool.map(_compile, [*copy.glob("native/*.c"), _translate(output)]))
    except (OSError, subprocess.CalledProcessError) as error:
        shutil.rmtree(copy)
        print(f"the emulator is not compiled, and slower: {error}")


main(Path(sys.argv[1]))
