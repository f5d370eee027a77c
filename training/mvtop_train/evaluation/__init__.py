"""How accurate a build and its models are: fixed test sets, outcomes, comparisons of two runs."""
