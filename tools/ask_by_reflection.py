#!/usr/bin/env python3
"""Asks a Terraquilt server by reflection alone, as grpcurl does: no file of the manual is needed.

  pip install grpcio grpcio-reflection
  tools/ask_by_reflection.py localhost:50051                                       # the services and their methods
  tools/ask_by_reflection.py localhost:50051 terraquilt.v1.Catalog/ListSurveys     # a call with an empty message
  tools/ask_by_reflection.py localhost:50051 terraquilt.v1.Query/Patches '{"tolerance":{"error_m":5}}'
  TERRAQUILT_TOKEN=tq_... tools/ask_by_reflection.py maps.example:443 --tls [--ca FILE]

The third word is one JSON message, or a list of them for a method that takes a stream; `bytes` are base64. Answers are printed
as JSON, one a line. Exit 1: the call failed, and its code and text are on standard error; 2: there is no such method, or the
message does not fit it.
"""

import argparse
import json
import os
import sys

import grpc
from google.protobuf import descriptor_pool, json_format, message_factory
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase


def connect(args):
    # A channel to the server; the token goes with every call, those of reflection included.
    options = [("grpc.max_receive_message_length", 8 << 20)]
    token = os.environ.get("TERRAQUILT_TOKEN")
    if args.tls:
        ca = open(args.ca, "rb").read() if args.ca else None
        channel = grpc.secure_channel(args.server, grpc.ssl_channel_credentials(ca), options)
    else:
        channel = grpc.insecure_channel(args.server, options)
    return grpc.intercept_channel(channel, Bearer(token)) if token else channel


class Bearer(
    grpc.UnaryUnaryClientInterceptor,
    grpc.UnaryStreamClientInterceptor,
    grpc.StreamUnaryClientInterceptor,
    grpc.StreamStreamClientInterceptor,
):
    """Adds the token to every call."""

    def __init__(self, token):
        self.pair = ("authorization", f"Bearer {token}")

    def add(self, next_call, details, request):
        return next_call(details._replace(metadata=[*(details.metadata or []), self.pair]), request)

    intercept_unary_unary = intercept_unary_stream = add
    intercept_stream_unary = intercept_stream_stream = add


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("server")
    arguments.add_argument("method", nargs="?", help="package.Service/Method; without it, all there are are listed")
    arguments.add_argument("message", nargs="?", default="{}")
    arguments.add_argument("--tls", action="store_true")
    arguments.add_argument("--ca", metavar="FILE")
    arguments.add_argument("--seconds", type=float, help="the time that the call may take")
    arguments.add_argument("--answers", type=int, help="stop after so many")
    args = arguments.parse_args()

    channel = connect(args)
    database = ProtoReflectionDescriptorDatabase(channel)
    pool = descriptor_pool.DescriptorPool(database)
    if args.method is None:
        for name in sorted(database.get_services()):
            for m in pool.FindServiceByName(name).methods:
                streams = ["stream " if s else "" for s in (m.client_streaming, m.server_streaming)]
                print(f"{name}/{m.name} ({streams[0]}{m.input_type.name}) -> {streams[1]}{m.output_type.name}")
        return 0

    service, _, name = args.method.partition("/")
    try:
        method = pool.FindServiceByName(service).methods_by_name[name]
    except KeyError:
        print(f"{args.method}: the server has no such method", file=sys.stderr)
        return 2
    request, reply = (message_factory.GetMessageClass(t) for t in (method.input_type, method.output_type))
    try:
        given = json.loads(args.message)
        messages = [json_format.ParseDict(m, request()) for m in (given if isinstance(given, list) else [given])]
    except (json.JSONDecodeError, json_format.ParseError) as e:
        print(f"{method.input_type.full_name}: {e}", file=sys.stderr)
        return 2
    # Every method can be called as one that streams both ways: on the wire a single message is a stream of one.
    call = channel.stream_stream(f"/{args.method}", request.SerializeToString, reply.FromString)
    answers = call(iter(messages), timeout=args.seconds)
    for k, answer in enumerate(answers, 1):
        print(json.dumps(json_format.MessageToDict(answer, preserving_proto_field_name=True)))
        if k == args.answers:
            answers.cancel()
            break
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except grpc.RpcError as e:
        print(f"{e.code().name}: {e.details()}", file=sys.stderr)
        sys.exit(1)
    except (BrokenPipeError, KeyboardInterrupt):
        sys.exit(0)
