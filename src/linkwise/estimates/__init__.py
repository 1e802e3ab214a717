"""What every estimator returns: values, covariance, links, and what can be said of them."""

from linkwise.estimates import text as text
