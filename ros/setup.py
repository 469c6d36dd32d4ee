"""The bridge as a package of ROS 2 (ament_python)."""

from setuptools import setup

NAME = "up_samp_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "README.md"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The up_samp authors",
    license="Apache-2.0",
    description='Drives robots with Nav2 as "up-samp operate" tells, over its HTTP interface',
    entry_points={"console_scripts": [f"bridge = {NAME}.node:main"]},
)
