"""Simulation of dough: MLS-MPM, rigid fingers and table."""
