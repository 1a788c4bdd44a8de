"""`python -m evpinn_ros`: the command `evpinn`."""

from evpinn_ros.cli.main import main

if __name__ == "__main__":
    main()
