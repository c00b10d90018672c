"""The numbers that decide how a picture looks, each with its unit in its name and with its origin.

One px is 1/100 inch, so that a picture has the same proportions on a page and in an image.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

Dash = Literal["solid", "dash", "dot", "dashdot", "longdash"]
Marker = Literal["circle", "square", "diamond", "triangle-up", "triangle-down", "pentagon", "cross"]
Screen = Literal["narrow", "wide", "paper"]

#: Pixels in an inch: a convention of this project, with which pages and images share one layout.
PX_PER_INCH: Final = 100
#: Points in an inch: a convention of typography.
PT_PER_INCH: Final = 72

#: The colours by name; derived from the palette of Okabe and Ito (2008), which colour-blind readers can tell
#: apart, darkened until thin lines keep a contrast of 3:1 on white.
COLORS = MappingProxyType({
    "red": "#c8500a", "blue": "#0072b2", "green": "#00916a", "gold": "#b07d00",
    "purple": "#a8478a", "sky": "#3f9fd6", "grey": "#76828c", "black": "#202020",
    "white": "#ffffff",
})  # fmt: skip
#: The shape of points by the name of their colour: one quantity has one colour and one shape, so that the
#: picture can be read without colours.
MARKERS: MappingProxyType[str, Marker] = MappingProxyType({
    "red": "circle", "blue": "square", "green": "triangle-up", "gold": "diamond",
    "purple": "triangle-down", "sky": "pentagon", "grey": "circle", "black": "cross",
    "white": "circle",
})  # fmt: skip
#: The colours of planes: "size" is perceptually uniform (Smith and van der Walt, 2015), "risk" grows from none.
COLOR_SCALES = MappingProxyType(
    {
        "size": ("#0b0724", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"),
        "risk": ("#ffffff", "#fde3b0", "#f9b36b", "#ea7a3f", "#c23b2c", "#7f1128"),
    }
)
#: Lines of levels, in this order; "dash" is left to theory.
LEVEL_DASHES: tuple[Dash, ...] = ("dot", "dashdot", "longdash")
#: Curves of a panel, in this order, so that they differ without colours.
CURVE_DASHES: tuple[Dash, ...] = ("solid", "longdash", "dashdot", "dot")
#: What stands before the name of a line or a point.
SYMBOLS: MappingProxyType[Dash | Marker, str] = MappingProxyType({
    "solid": "\u2500\u2500\u2500", "dash": "- - -", "dot": "\u00b7 \u00b7 \u00b7", "dashdot": "\u2500 \u00b7 \u2500", "longdash": "\u2500\u2500 \u2500\u2500",
    "circle": "\u25cf", "square": "\u25a0", "diamond": "\u25c6", "triangle-up": "\u25b2",
    "triangle-down": "\u25bc", "pentagon": "\u2b1f", "cross": "\u2715",
})  # fmt: skip
#: Letters of the text that fit beside each other above a panel; chosen by eye in chromium with 11 px letters on a
#: phone of 390 px, a page of 960 px and paper of 680 px.
LETTERS_BY_SCREEN: MappingProxyType[Screen, int] = MappingProxyType({
    "narrow": 44, "wide": 130, "paper": 100,
})  # fmt: skip
#: Letters in a line of a name beside its curve; chosen by eye in chromium: on a phone four fifths of the width are left.
NAME_LETTERS: MappingProxyType[Screen, int] = MappingProxyType({
    "narrow": 13, "wide": 20, "paper": 18,
})  # fmt: skip


def hex_color(name: str) -> str:
    """Return a colour by its name.

    Raises
    ------
    ValueError
        For a name that is none, with those that are.
    """
    if name not in COLORS:
        raise ValueError(f"color {name!r} must be one of {', '.join(COLORS)}")
    return COLORS[name]


@dataclass(frozen=True)
class Style:
    """What a picture looks like.

    Attributes whose names end in `px`, `pt` and `in` are lengths in pixels, points and inches; those that end
    in `share` are shares of the length that their comment names.
    """

    #: width of a curve; chosen: seen from an arm's length, and thin enough for twenty turns side by side
    line_width_px: float = 1.6
    #: width of a curve over a plane; chosen: it stands out between the colours
    plane_line_width_px: float = 2.4
    #: width of the rim around what is drawn over a plane; derived from plane_line_width_px, 0.8 px on each side
    rim_width_px: float = 2.4 + 2 * 0.8
    #: width of the bar for an error; chosen: thinner than a curve
    error_width_px: float = 1.2
    #: width of the line of a mark; chosen: it says less than a curve
    mark_width_px: float = 1.2
    #: width of the rim around letters that stand on lines; chosen
    halo_px: float = 3.0
    #: width of the edge of a span; chosen: it is there but says less than a mark
    span_edge_px: float = 0.6
    #: width of the edge of a span over a plane, where its inside is left clear; chosen
    plane_span_edge_px: float = 2.5
    #: size of a point; chosen: three times a curve's width
    marker_px: float = 5.0
    #: size of one of many points; chosen: a cloud of them stays a cloud of points
    many_markers_px: float = 3.0
    #: size of a point over a plane, and of its rim; chosen
    plane_marker_px: float = 7.0
    #: what the rim of a point over a plane adds to its size; chosen
    rim_marker_px: float = 2.0
    #: size of the cross where something is not determined; chosen: larger than a point
    undetermined_marker_px: float = 7.0
    #: where that cross stands above the foot of its panel, as a share of its height; chosen
    undetermined_share: float = 0.03
    #: size of the head of an arrow; chosen: twice a point
    arrow_head_px: float = 10.0

    #: opacity of an error's band; chosen: the curve and the grid stay visible through it
    band_opacity: float = 0.2
    #: opacity of a stacked area and of a bar in a lane; chosen: darker than a band, so that areas differ
    area_opacity: float = 0.35
    #: opacity of a span; chosen: the lightest of all, as it lies below everything
    span_opacity: float = 0.14
    #: opacity of the grid; chosen: seen only by those who look for it
    grid_opacity: float = 0.25

    #: free length beside the values of an axis, as a share of what it shows; chosen
    free_share: float = 0.05
    #: free length beside the outermost points of an x axis; chosen: half a point stays inside
    free_at_points_share: float = 0.03
    #: most values of a grid that are ticks of their axis; chosen: so many numbers stand beside each other
    max_grid_ticks: int = 6
    #: letters in a line of a tick's text at least; else a renderer turns the text. Chosen: a short word
    min_tick_letters: int = 6
    #: the width that the bars of one place share, of the distance between places; chosen: bars of a place
    #: stand together
    bars_share: float = 0.8
    #: height of a bar in a lane, as a share of the lane; chosen: a gap separates lanes
    lane_bar_share: float = 0.84

    #: height of a line of labels; derived from 11 px letters with a leading of 1.7
    text_line_px: float = 11 * 1.7
    #: free height above a panel; chosen: one line
    gap_px: float = 18.0
    #: height of a line of a name beside its curve; derived from 11 px letters with a leading of 1.25
    name_line_px: float = 11 * 1.25
    #: width of a letter of such a name; measured with 11 px letters in chromium
    name_letter_px: float = 6.4
    #: width of the piece of a line before it; chosen: two of the longest dashes
    handle_px: float = 28.0
    #: the same with a gap
    symbol_px: float = 32.0
    #: free letters beside a label; chosen: labels do not touch
    label_gap_letters: int = 2
    #: how far a label is from its line and from the picture below it; chosen: half a letter
    label_shift_px: float = 4.0
    #: width of a letter of a rotated label; chosen by eye in chromium with 12 px letters
    rotated_letter_px: float = 7.7
    #: size of the letters of a page's axes; chosen: that of captions on the page
    axis_text_px: float = 12.0
    #: size of the letters of labels; chosen: below that of axes
    label_text_px: float = 11.0

    #: height of the only panel; chosen: half its width on a page
    single_panel_px: float = 330.0
    #: height of one of two panels; chosen: both fit on a screen of 700 px
    double_panel_px: float = 250.0
    #: height of one of more panels; chosen: four fit on a screen of 900 px
    panel_px: float = 190.0
    #: height of a lane; chosen: a line of text with its edges
    lane_px: float = 30.0
    #: width of a plane on a page; chosen: that of the narrowest screen without its axis and the bar of colours
    plane_width_px: float = 240.0
    #: height of a plane; chosen: as wide as high on a small screen
    plane_px: float = 380.0
    #: panels on paper keep at least this share of their height; chosen: curves stay legible
    least_panel_share: float = 0.3
    #: height below the x axis for its ticks and label; chosen by eye in chromium
    below_px: float = 52.0
    #: height for an axis with the second unit; chosen by eye in chromium
    second_axis_px: float = 44.0
    #: width of the page's left margin before it grows with its labels; chosen
    left_px: float = 60.0
    #: width of the page's right margin; chosen: half of the last tick's number
    right_px: float = 14.0
    #: width of a picture on paper; derived from A4 with margins of 14 mm at 96 px to the inch, rounded down
    paper_width_px: float = 680.0
    #: width of the bar that explains the colours of a plane; chosen
    color_bar_px: float = 12.0
    #: most points of a curve on a page; chosen: two for each px of a wide screen
    max_points: int = 2000

    #: pictures beside each other in an image; chosen: it stays legible across a screen
    max_pictures_across: int = 3
    #: width of a picture in an image of several; chosen
    image_width_in: float = 6.5
    #: width of the only picture of an image; chosen: a page of A4 with margins
    single_image_width_in: float = 8.0
    #: height of a motion's still frames in an image; chosen
    still_height_in: float = 5.2
    #: height for the title of each picture and of an image; chosen: two lines
    title_height_in: float = 0.5
    #: letters of the title in an inch of an image; measured with 9 pt letters
    title_letters_per_in: int = 9
    #: letters of a picture's title in a line; measured with 10 pt letters across image_width_in
    picture_title_letters: int = 85
    #: size of letters in an image; chosen
    image_text_pt: float = 9.0
    #: size of a picture's title in an image; chosen
    image_title_pt: float = 10.0
    #: size of labels and names in an image; chosen
    image_label_pt: float = 8.0
    #: resolution of an image; chosen: sharp when printed at half of its size
    image_dpi: int = 120
    #: the faintest ghost of a motion; chosen: it is still seen
    faintest_ghost: float = 0.25


STYLE = Style()
