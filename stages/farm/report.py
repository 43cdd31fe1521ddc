def written_report(table):
    return {"page": "none"}
