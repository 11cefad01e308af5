"""Reads an MCAP file with the public reader, and prints what is in it as JSON."""
import json
import sys

from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    messages = [
        {
            "schema": schema.encoding,
            "properties": json.loads(schema.data)["properties"],
            "topic": channel.topic,
            "encoding": channel.message_encoding,
            "log_time": message.log_time,
            "publish_time": message.publish_time,
            "data": json.loads(message.data),
        }
        for schema, channel, message in reader.iter_messages()
    ]
print(json.dumps({"count": summary.statistics.message_count, "messages": messages}))
