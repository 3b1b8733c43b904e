"""Fuzzing: one function a target that takes any bytes, run by hypothesis in CI and by atheris in `make fuzz`."""
