"""float64 by default, and the shapes and dtypes in every signature checked at run time."""

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)

# Before the first import of either package: the hook rewrites modules as they are loaded.
install_import_hook(["jaxsph", "inverse"], "beartype.beartype")
