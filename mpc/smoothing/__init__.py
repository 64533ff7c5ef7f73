"""The CasADi layer: smoother plans that still minimise the learned distance."""
