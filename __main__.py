"""python -m leaflight: the command line, on pip's bpy."""

import sys


def main() -> int:
    """Run the command line and give its exit code."""
    try:
        import bpy  # noqa: F401  tried first, for a sentence instead of a traceback
    except ImportError as reason:
        print(
            f"leaflight: error: Blender as a Python module (bpy) cannot be loaded: {reason}\n"
            "Install it with `pip install bpy`, or bake with `blender -b SCENE.blend --command leaflight bake`.",
            file=sys.stderr,
        )
        return 1
    from .addon import cli

    return cli.main(sys.argv[1:], prog="python -m leaflight", with_scene=True)


if __name__ == "__main__":
    sys.exit(main())
