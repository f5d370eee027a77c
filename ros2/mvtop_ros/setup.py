from setuptools import setup

NAME = "mvtop_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/mvtop.launch.py"]),
        (f"share/{NAME}/config", ["config/mvtop.yaml"]),
    ],
    install_requires=["setuptools", "mvtop", "numpy", "pillow"],
    zip_safe=True,
    maintainer="mvtop",
    maintainer_email="mvtop@example.org",
    description="6-DoF poses of known parts from several calibrated cameras",
    license="MIT OR Apache-2.0",
    entry_points={
        "console_scripts": [
            "mvtop = mvtop_ros.node:main",
            "bpc_pose_estimator = mvtop_ros.challenge:main",
        ],
    },
)
