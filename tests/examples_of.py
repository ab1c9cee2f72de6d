"""Examples as functions, for their tests."""

import importlib.util


def runner(folder, out):
    """Runs the main function of an example in a folder, with its picture in `out`, that must then hold one."""

    def run(name, **options):
        spec = importlib.util.spec_from_file_location(f"example_{name}", folder / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        picture = out / "pictures" / f"{name}.png"
        result = module.main(**options, picture=str(picture))
        assert picture.read_bytes().startswith(b"\x89PNG")
        return result

    return run
