"""Classification of complete sentences: tables of the paper, peers, ablations, sim-to-real."""
