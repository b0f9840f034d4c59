"""`phm doctor`: what PHM can use on this machine. One module for each group of rows; `examination` runs them."""
