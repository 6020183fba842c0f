"""How the page of the rig is drawn: the only part of palpation that knows NiceGUI."""
