"""The arm of running nodes on the page: pose, spot and trace, plots, and what the nodes say of themselves."""
