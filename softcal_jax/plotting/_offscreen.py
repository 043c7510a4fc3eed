"""OpenGL without a screen.

The VTK wheel links no graphics library. It loads one for the first picture, and if it
finds none, the process dies of a segmentation fault. So this module looks for a library
first, and tells VTK which one to use.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"

_REMEDY = (
    "pictures of the body cannot be drawn, as this machine has no OpenGL that works "
    "without a screen. On Debian or Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
)


class RenderingError(RuntimeError):
    """This machine cannot draw pictures of a body."""


def rendering_problem() -> str | None:
    """Say why bodies cannot be drawn here, and the remedy; None if they can."""
    try:
        _backend()
    except RenderingError as error:
        return str(error)
    return None


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK draw without a screen; make and close its window inside the block.

    Raises:
        RenderingError: If no suitable OpenGL is installed.
    """
    backend = _backend()
    if backend is not None:
        os.environ[_CHOICE] = backend
    try:
        yield
    finally:
        if backend is not None:
            del os.environ[_CHOICE]


def _backend() -> str | None:
    """Choose VTK's render window; None where its own choice is right."""
    if not sys.platform.startswith("linux") or os.environ.get(_CHOICE):
        return None  # macOS and Windows need no choice, or the user has chosen
    # A program that already shows windows by GLX must stay with it: EGL would fail. It
    # needs a display for that; without one, gmsh has loaded the library and no more.
    maps = Path("/proc/self/maps").read_text(errors="replace")
    if os.environ.get("DISPLAY") and "/libGLX" in maps and "/libEGL" not in maps:
        return None
    # Avoid X11 otherwise: it warns without a DISPLAY and fails with a stale one.
    return _headless_backend()


@functools.cache
def _headless_backend() -> str:
    osmesa = (f"libOSMesa.so{end}" for end in (".8", ".6", ""))
    if _can_load("libEGL.so.1") and _egl_works():
        return "vtkEGLRenderWindow"
    if any(map(_can_load, osmesa)):
        return "vtkOSOpenGLRenderWindow"
    raise RenderingError(_REMEDY)


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _egl_works() -> bool:
    """Check that EGL finds a driver; libEGL may be installed without one."""
    from vtkmodules.vtkCommonCore import vtkLogger
    from vtkmodules.vtkRenderingOpenGL2 import vtkEGLRenderWindow

    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        window = vtkEGLRenderWindow()
        window.SetOffScreenRendering(True)
        works = bool(window.SupportsOpenGL())
        window.Finalize()
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
    return works
