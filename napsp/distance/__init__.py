"""d(s, a, g): the network, its labels, and the counts behind them."""
