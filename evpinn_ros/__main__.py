"""`python -m evpinn_ros`: the command `evpinn`."""

from evpinn_ros.executables import evpinn

if __name__ == "__main__":
    evpinn()
