"""Sources of rows: what each kind of recording says about friction, as equations for `rx90_common.estimation`."""
