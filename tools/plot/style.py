"""How the figures look, and how they are saved: the same bytes from the same input."""

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Colours that stay apart for colour-blind readers (Okabe & Ito).
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#7F7F7F"

MODE_COLOURS = {
    "track": BLUE,
    "regulated": ORANGE,
    "conservative_turn": VERMILION,
    "conservative_go": PURPLE,
    "blocked": BLACK,
}
MODE_NAMES = {
    "track": "track",
    "regulated": "regulated",
    "conservative_turn": "conservative, turn",
    "conservative_go": "conservative, go",
    "blocked": "blocked",
}
# The same on axis ticks, where there is little room.
MODE_TICKS = dict(MODE_NAMES, conservative_turn="cons. turn", conservative_go="cons. go")
# Where colours tell strategies apart, greys tell modes apart.
MODE_GREYS = {
    "track": "#E9E9E9",
    "regulated": "#ABABAB",
    "conservative_turn": "#3A3A3A",
    "conservative_go": "#787878",
    "blocked": BLACK,
}
STRATEGY_COLOURS = {
    "none": GREY,
    "conservative": GREEN,
    "combined": BLUE,
    "normal": VERMILION,
    "adaptive": ORANGE,
    "kanayama": SKY,
    "kanayama_avoid": PURPLE,
}
STRATEGY_DASHES = {
    "none": (0, (1, 1.2)),
    "normal": (0, (5, 1.4)),
    "adaptive": (0, (5, 1.4)),
    "kanayama": (0, (3, 1, 1, 1)),
    "kanayama_avoid": (0, (6, 1, 1, 1, 1, 1)),
}

REFERENCE = "#555555"
HARD = "#5A5A5A"
RING = "#808080"

RC = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "legend.fontsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "lines.linewidth": 1.1,
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.handlelength": 2.0,
    "legend.columnspacing": 1.3,
    "legend.labelspacing": 0.35,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "berth",
}

# Dates and versions would make two equal figures differ.
_METADATA = {
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
    "png": {"Software": None},
}


def apply():
    """Starts from matplotlib's own defaults, whatever the user's matplotlibrc says."""
    matplotlib.rcdefaults()
    matplotlib.rcParams.update(RC)


def new_figure(width, height):
    """A figure of so many inches; a page's text width is about 7.2."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, wspace=0.03, hspace=0.02)
    return figure


def save(figure, stem, endings=tuple(_METADATA)):
    """Writes stem.pdf, stem.svg and stem.png, or some of them, in one layout."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for ending in endings:
        figure.savefig(f"{stem}.{ending}", metadata=_METADATA[ending])


def strategy_colour(strategy):
    """The same in every figure."""
    return STRATEGY_COLOURS.get(strategy, BLACK)


def strategy_line(strategy):
    """For paths, which lie on top of each other: dashes besides the colour."""
    return {
        "color": strategy_colour(strategy),
        "linestyle": STRATEGY_DASHES.get(strategy, "solid"),
    }
