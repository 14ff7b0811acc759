"""doughnet: the model that predicts how dough deforms, splits, merges and gets holes."""
