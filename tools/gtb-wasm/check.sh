#!/usr/bin/env bash
# The decoder of GTB in WebAssembly against the native one: the same streams, cut at the same bytes, must give the same surfaces,
# bit by bit. Says "skipped" where no compiler for wasm32-unknown-unknown, or no Node, can be had.
#
#   tools/gtb-wasm/check.sh [FILE.gtb ...]              without files: streams that the native side makes
#
# The compiler: the toolchain in use, to which rustup adds the target; else Debian's packages (rustc-web, rust-web-src and what they
# stand on: about 140 MB), fetched and unpacked under the build folder, nothing installed.
set -euo pipefail
# Files are named from where the caller stands.
files=()
for file in "$@"; do files+=("$(realpath -- "$file")"); done
set -- "${files[@]+"${files[@]}"}"
cd "$(dirname "$0")"
target=wasm32-unknown-unknown
build=${CARGO_TARGET_DIR:-$PWD/../../target/gtb-wasm}
mkdir -p "$build"
build=$(cd "$build" && pwd)
export CARGO_TARGET_DIR=$build
skip() { echo "skipped: $1"; exit 0; }
command -v node >/dev/null || skip "no Node"

# Debian's compiler, its standard library's sources and its LLVM, unpacked under $1. Its program needs its own folder of libraries.
debian() {
  [ -x "$1/rustc" ] && return 0
  command -v apt-get >/dev/null && command -v dpkg-deb >/dev/null || return 1
  local fresh=$1.part
  rm -rf "$fresh" && mkdir -p "$fresh/usr" && (
    cd "$fresh"
    get() { timeout 300 apt-get download -qq "$@" 2>/dev/null; }
    get rustc-web libstd-rust-web-dev rust-web-src || exit 1
    get "$(dpkg-deb -f libstd-rust-web-dev_*.deb Depends | grep -o 'libstd-rust-web-[0-9.]*' | head -1)" || exit 1
    get "$(dpkg-deb -f libstd-rust-web-[0-9]*.deb Depends | grep -o 'libllvm[0-9]*' | head -1)" || exit 1
    for deb in rustc-web_* libstd-rust-web-* libllvm*; do dpkg-deb -x "$deb" . || exit 1; done
    dpkg-deb --fsys-tarfile rust-web-src_* | tar -x --wildcards './usr/src/rustc-*/library/*' './usr/lib/*' || exit 1
    rm ./*.deb
    printf '#!/bin/sh\nLD_LIBRARY_PATH="%s" exec "%s" "$@"\n' "$1/usr/lib/$(uname -m)-linux-gnu" "$1/usr/bin/rustc" >rustc
    chmod +x rustc
  ) && mv "$fresh" "$1" && "$1/rustc" --version >/dev/null 2>&1
}

std=()
own=$(rustc --print sysroot)/lib/rustlib
if [ -d "$own/$target" ] || timeout 120 rustup target add $target >/dev/null 2>&1; then
  echo "compiler: $(rustc --version)"
else
  debian "$build/debian" || skip "no compiler for $target: rustup and apt-get fetch none"
  export RUSTC=$build/debian/rustc
  export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=$(echo "$own"/*/bin/rust-lld)
  echo "compiler: $($RUSTC --version), with the standard library from its sources"
  std=(-Z build-std=std,panic_abort)
fi
RUSTC_BOOTSTRAP=1 cargo build --quiet --release --lib --target $target ${std[@]+"${std[@]}"}
unset RUSTC
cargo build --quiet --release --example native

module=$build/$target/release/gtb_wasm.wasm
native=$build/release/examples/native
echo "module: $(stat -c %s "$module") bytes"
if [ $# -eq 0 ]; then
  rm -rf "$build/streams" && mkdir "$build/streams"
  "$native" streams "$build/streams"
  set -- "$build"/streams/*.gtb
fi
for file in "$@"; do
  cuts="0 7 60 $(for k in 1 2 5 20 50 90 99; do echo $(($(stat -c %s "$file") * k / 100)); done)"
  "$native" decode "$file" $cuts >"$build/native.txt"
  node decode.mjs "$module" "$file" $cuts >"$build/wasm.txt"
  diff "$build/native.txt" "$build/wasm.txt"
  echo "$(basename "$file"): $(wc -l <"$build/wasm.txt") prefixes, the same answers; the whole: $(tail -1 "$build/wasm.txt")"
done
