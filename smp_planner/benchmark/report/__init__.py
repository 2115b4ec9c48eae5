"""The report on results: what the rows say, in sentences, tables, charts and one page of HTML."""
