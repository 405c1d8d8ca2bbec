"""Where samples are worked on: this process or several."""
