"""What a plan is and what it costs: batched rollouts, costs, the receding-horizon loop."""
