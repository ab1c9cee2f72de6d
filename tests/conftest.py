"""float64 by default, and the shapes and dtypes in every signature checked at run time."""

import os

# Most of a test is compiling. Without LLVM's own passes and without an intermediate language for each fused loop it
# takes less than half, what runs takes twice as long, and roundings may differ: test_compiler.py looks at those.
# Those who set XLA_FLAGS themselves have theirs.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")

import jax
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)

# Before the first import of either package: the hook rewrites modules as they are loaded.
install_import_hook(["jaxsph", "inverse"], "beartype.beartype")


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_programs():
    """A file's programs are of no use to the next one, and all of them together take some gigabytes."""
    yield
    jax.clear_caches()
