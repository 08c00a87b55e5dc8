"""The video of an episode: a camera, two renderers, and what they were made with."""
