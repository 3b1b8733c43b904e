"""`python -m gateway` is `robot-gateway`."""

from gateway.cli.main import run

if __name__ == "__main__":
    run()
