"""Results of estimators: values, covariance, links, findings and their text."""

from linkwise.estimates import text as text
