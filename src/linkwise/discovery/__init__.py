"""Who is linked to whom, and by which law: choosing among all links and terms that could be (METHODS section 9)."""

from linkwise.discovery import text as text
