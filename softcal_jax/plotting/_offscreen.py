"""OpenGL without a screen.

The VTK wheel links no graphics library: it loads one when the first picture is drawn,
and where it finds none the whole process dies of a segmentation fault. So the library
is looked for here first, and VTK is told which to take.
"""

import ctypes
import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"
_EGL, _OSMESA = "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"

_REMEDY = (
    "pictures of the body cannot be drawn: this machine has no OpenGL that works "
    "without a screen. On Debian or Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
)


class RenderingError(RuntimeError):
    """This machine cannot draw pictures of a body."""


def rendering_problem() -> str | None:
    """Why pictures of a body cannot be drawn here, and the remedy; None if they can."""
    try:
        _backend()
    except RenderingError as error:
        return str(error)
    return None


@contextmanager
def offscreen() -> Iterator[None]:
    """Lets VTK draw without a screen; a window must be made and closed inside.

    Raises:
        RenderingError: If no suitable OpenGL is installed.
    """
    backend = _backend()
    if backend is None:
        yield
        return
    os.environ[_CHOICE] = backend
    try:
        yield
    finally:
        del os.environ[_CHOICE]


def _backend() -> str | None:
    """The render window that VTK should take; None where its own choice is right."""
    if not sys.platform.startswith("linux") or os.environ.get(_CHOICE):
        return None  # macOS and Windows draw by themselves; a user may have chosen
    # A program that shows windows through GLX must go on with it: EGL beside it fails.
    maps = Path("/proc/self/maps").read_text(errors="replace")
    if "/libGLX" in maps and "/libEGL" not in maps:
        return None
    # Never X11 otherwise: it warns without a DISPLAY and fails with a stale one.
    return _headless_backend()


@functools.cache
def _headless_backend() -> str:
    if _can_load("libEGL.so.1") and _egl_works():
        return _EGL
    if any(_can_load(f"libOSMesa.so{end}") for end in (".8", ".6", "")):
        return _OSMESA
    raise RenderingError(_REMEDY)


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _egl_works() -> bool:
    """Whether EGL finds a driver; libEGL may be there without one."""
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
