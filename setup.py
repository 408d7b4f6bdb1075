"""Build the rx90_emulator package, with colcon (ament_python) or with pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "rx90_emulator"
EXECUTABLES = ("rx90", "rx90_sim", "rx90_controller", "rx90_cell", "friction_bench")


def data_files() -> list[tuple[str, list[str]]]:
    """List config/, launch/ and firmware/ folder by folder, and what reports quote, for `share/rx90_emulator`."""
    entries = [
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/docs/reference", ["docs/reference/glossary_and_works.md"]),
    ]
    for root in ("config", "launch", "firmware"):
        folders = [Path(root), *sorted(p for p in Path(root).rglob("*") if p.is_dir())]
        for folder in folders:
            files = sorted(str(p) for p in folder.iterdir() if p.is_file())
            if files:
                entries.append((f"share/{NAME}/{folder}", files))
    return entries


VIEW = ["viser>=1.1,<1.2"]
DXF = ["ezdxf>=1.4,<2"]
DOCS = [
    "sphinx>=8.1,<9.1",
    "myst-parser>=4,<6",
    "myst-nb>=1.4,<2",
    "furo>=2025.12,<2026.12",
    "sphinx-argparse>=0.5.2,<0.7",
    "sphinx-copybutton>=0.5.2,<0.6",
]
TEST = [
    "pytest>=8.3,<10",
    "pytest-xdist>=3.6,<4",
    "hypothesis>=6.120,<7",
    "jsonschema>=4.20,<5",
    "mcap>=1.2,<2",
    "xacro>=2.0,<3",
]

setup(
    name=NAME,
    version="0.1.0",
    description="Emulator of the Staubli RX90B robot, its CS7B controller and a friction rig",
    license="Apache-2.0",
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=["rx90_*", "friction_bench*"]),
    package_data={"": ["py.typed", "templates/*", "*.lark"]},
    data_files=data_files(),
    zip_safe=False,
    install_requires=[
        "numpy>=1.26,<2.5",
        "scipy>=1.11,<1.18",
        "numba>=0.59,<0.69",
        "pin>=2.7,<4.2",
        "rosbags>=0.11.9,<0.12",
        "pyarrow>=18,<27",
        "PyYAML>=6.0.1,<7",
        "pydantic>=2.14,<2.15",
        "matplotlib>=3.6,<3.12",
        "Jinja2>=3.1.2,<4",
        "bokeh>=3.9,<3.10",
        "markdown-it-py>=3,<5",
        "tqdm>=4.66,<5",
        "pyserial>=3.5,<4",
        "shtab>=1.13,<2",
        "lark-parser>=0.12,<0.13",
    ],
    extras_require={
        "ros": [
            "ros-jazzy-rclpy[fastrtps]>=7.1.6,<7.2",
            "ros-jazzy-common-interfaces>=5.3.6,<5.4",
        ],
        "sweep": ["distributed>=2026.1,<2027"],
        "docs": DOCS,
        "view": VIEW,
        "dxf": DXF,
        "test": TEST,
        "dev": [
            *TEST,
            *VIEW,
            "mujoco>=3.17,<4.1",
            *DXF,
            "playwright>=1.50,<2",
            "distributed>=2026.1,<2027",
            "pandas>=2.2,<4",
            "wheel>=0.42,<1",
            "nbclient>=0.10,<0.12",
            "nbformat>=5.10,<6",
            "ipykernel>=6.29,<8",
            "colcon-common-extensions>=0.3.0,<0.4",
            "ruff>=0.17,<0.18",
            "mypy>=2.4,<2.5",
            "types-PyYAML>=6.0.12,<7",
            "types-tqdm>=4.67,<5",
            "scipy-stubs>=1.15,<1.18",
        ],
    },
    entry_points={
        "console_scripts": [f"{name} = rx90_emulator.cli.frame:{name}" for name in EXECUTABLES],
    },
)
