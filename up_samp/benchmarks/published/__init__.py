"""The families in the forms in which their authors publish them."""
