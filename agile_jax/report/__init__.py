"""The report of a run: figures, video and one HTML file that stands alone.

Figures are drawn on Matplotlib's Axes (`draw_...`) or are a Figure of several (`..._figure`); `save_figure` writes one.
Matplotlib, Pillow and the video encoder live here."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
