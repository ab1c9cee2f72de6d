"""How programs are compiled outside of these tests; tests/conftest.py chooses what compiles sooner."""

USUAL = {"xla_backend_optimization_level": 3, "xla_cpu_use_fusion_emitters": True}
