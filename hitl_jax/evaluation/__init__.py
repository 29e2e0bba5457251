"""The test phase: trained walkers over many episodes, alone and with the human."""
