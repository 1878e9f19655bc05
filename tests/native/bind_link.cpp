// The board's end of the link, its parameters and their flash.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "convert.hpp"
#include "harness_board.hpp"
#include "link/cobs.hpp"
#include "link/crc32.hpp"
#include "link/frame_writer.hpp"
#include "link/link.hpp"
#include "link/parser.hpp"
#include "link/telemetry.hpp"
#include "params/params.hpp"
#include "params/store.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli::link::FrameWriter;
using heli::link::kChannelCount;
using heli::link::Link;
using heli::link::Packed;
using heli::link::Parser;
using heli::link::Request;
using heli::link::Sample;
using heli::params::Params;
using heli::params::Store;
using heli_test::Bytes;
using heli_test::data_of;
using heli_test::HarnessBoard;
using heli_test::to_python;

using RawTicks =
    nb::ndarray<const std::int32_t, nb::shape<-1, kChannelCount>, nb::c_contig, nb::device::cpu>;

Bytes copy_of(const nb::bytes& from) { return {data_of(from), data_of(from) + from.size()}; }

// Link, parameters and store on one board. Python plays the control tick.
class LinkHarness {
 public:
  LinkHarness(std::int16_t duty_full, std::size_t page_bytes)
      : board(duty_full, page_bytes), store(board), link(board, params, store, tape, controllers) {
    controllers.name[0] = "cascade";
    controllers.name[1] = "sixteen_letters_and_more";
    controllers.count = 2;
    store.load(params);
  }

  HarnessBoard board;
  Params params;
  Store store;
  heli::law::Tape tape;
  heli::link::ControllerNames controllers;
  Link link;
};

std::optional<std::tuple<int, nb::bytes>> take_request(const LinkHarness& harness) {
  const Request* request = harness.link.take_request();
  if (request == nullptr) return std::nullopt;
  return std::tuple(static_cast<int>(request->id), to_python(request->payload, request->size));
}

std::optional<std::tuple<int, nb::bytes>> take_stream(LinkHarness& harness) {
  heli::link::StreamValue value;
  if (!harness.link.take_stream(value)) return std::nullopt;
  const auto packed = [&value](const auto& message) {
    Bytes payload(message.kSize);
    message.write(payload.data());
    return std::tuple(static_cast<int>(value.id), to_python(payload));
  };
  switch (value.id) {
    case heli::link::MessageId::setpoint:
      return packed(value.setpoint);
    case heli::link::MessageId::voltages:
      return packed(value.voltages);
    default:
      return packed(value.following);
  }
}

std::vector<Sample> samples_of(std::uint32_t first_tick, const RawTicks& raw) {
  std::vector<Sample> samples(raw.shape(0));
  for (std::size_t k = 0; k < samples.size(); ++k) {
    samples[k].tick = first_tick + static_cast<std::uint32_t>(k);
    std::copy_n(raw.data() + k * kChannelCount, kChannelCount, samples[k].raw);
  }
  return samples;
}

std::vector<nb::bytes> pack_telemetry(std::uint32_t first_tick, const RawTicks& raw) {
  const std::vector<Sample> samples = samples_of(first_tick, raw);
  std::vector<nb::bytes> payloads;
  for (std::size_t at = 0; at < samples.size();) {
    std::uint8_t payload[heli::link::kMaxTelemetryPayload];
    const std::size_t count = std::min(samples.size() - at, heli::link::kMaxBatchTicks);
    const Packed packed = heli::link::pack_batch(samples.data() + at, count, payload);
    payloads.push_back(to_python(payload, packed.bytes));
    at += packed.samples;
  }
  return payloads;
}

nb::bytes cobs_encode(const nb::bytes& plain) {
  Bytes encoded(heli::link::cobs_bytes(plain.size()) + 1);
  heli::link::CobsEncoder cobs(encoded.data());
  for (const std::uint8_t byte : copy_of(plain)) cobs.put(byte);
  encoded.resize(cobs.finish() - 1);
  return to_python(encoded);
}

nb::bytes cobs_decode(const nb::bytes& encoded) {
  heli::link::CobsDecoder cobs;
  Bytes plain;
  for (const std::uint8_t byte : copy_of(encoded)) {
    std::uint8_t decoded = 0;
    if (byte == 0) throw nb::value_error("a zero byte is the delimiter, not data");
    if (cobs.put(byte, decoded)) plain.push_back(decoded);
  }
  if (!cobs.whole()) throw nb::value_error("the last block is cut short");
  return to_python(plain);
}

std::vector<std::tuple<int, int, nb::bytes>> feed(Parser& parser, const nb::bytes& bytes) {
  std::vector<std::tuple<int, int, nb::bytes>> frames;
  for (const std::uint8_t byte : copy_of(bytes)) {
    if (!parser.put(byte)) continue;
    const auto& frame = parser.frame();
    frames.emplace_back(frame.id, frame.sequence, to_python(frame.payload, frame.size));
  }
  return frames;
}

nb::bytes write_frame(FrameWriter& writer, std::uint8_t id, const nb::bytes& payload) {
  Bytes wire(FrameWriter::wire_bytes(payload.size()));
  wire.resize(writer.write(id, data_of(payload), payload.size(), wire.data()));
  return to_python(wire);
}

void bind_codec(nb::module_& m) {
  m.def(
      "crc32",
      [](const nb::bytes& bytes, std::uint32_t before) {
        return heli::link::crc32(data_of(bytes), bytes.size(), before);
      },
      "data"_a, "before"_a = 0);
  m.def("cobs_encode", &cobs_encode, "plain"_a, "Without the delimiter.");
  m.def("cobs_decode", &cobs_decode, "encoded"_a,
        "Without the delimiter; ValueError if cut short.");
  m.def("pack_telemetry", &pack_telemetry, "first_tick"_a, "raw"_a,
        "Payloads of the batches that carry the ticks, an int32 array of shape (n, channels).");
  nb::class_<Parser>(m, "Parser")
      .def(nb::init<>())
      .def("feed", &feed, "data"_a, "Frames completed by these bytes, as (id, sequence, payload).")
      .def_prop_ro("frames_ok", &Parser::frames_ok)
      .def_prop_ro("frames_bad", &Parser::frames_bad)
      .def_prop_ro("frames_lost", &Parser::frames_lost)
      .def_prop_ro("bytes_dropped", &Parser::bytes_dropped);
  nb::class_<FrameWriter>(m, "FrameWriter")
      .def(nb::init<>())
      .def("write", &write_frame, "message_id"_a, "payload"_a, "The frame with its delimiter.");
}

void bind_params(nb::module_& m) {
  nb::class_<HarnessBoard>(m, "Board")
      .def(nb::init<std::int16_t, std::size_t>(), "duty_full"_a, "page_bytes"_a)
      .def_prop_rw(
          "flash", [](const HarnessBoard& board) { return to_python(board.flash); },
          [](HarnessBoard& board, const nb::bytes& all) {
            if (all.size() != board.flash.size()) {
              throw nb::value_error("the flash is two pages long");
            }
            board.flash = copy_of(all);
          },
          "Both pages one after the other.")
      .def_rw("steps_left", &HarnessBoard::steps_left, nb::arg().none(),
              "Bytes that may still be erased or written before power fails; None: it never does.");
  nb::class_<Params>(m, "Params")
      .def(nb::init<>())
      .def("get", [](const Params& p, int i) { return p.get(static_cast<heli::link::Param>(i)); })
      .def(
          "set",
          [](Params& p, std::uint8_t i, float value, bool idle) {
            return static_cast<int>(p.set(static_cast<heli::link::Param>(i), value, idle));
          },
          "index"_a, "value"_a, "idle"_a, "The result code.")
      .def("defaults", &Params::defaults)
      .def("values",
           [](const Params& p) {
             return std::vector<float>(p.data(), p.data() + heli::link::kParamCount);
           })
      .def("consistent", &Params::consistent)
      .def_prop_ro("revision", &Params::revision);
  nb::class_<Store>(m, "Store")
      .def(
          "__init__", [](Store* store, HarnessBoard& board) { new (store) Store(board); },
          "board"_a, nb::keep_alive<1, 2>())
      .def("load", [](Store& s, Params& p) { return static_cast<int>(s.load(p)); })
      .def("save", &Store::save)
      .def("drop", [](Store& s, Params& p,
                      std::uint8_t i) { s.drop(p, static_cast<heli::link::Param>(i)); })
      .def_prop_ro("source", [](const Store& s) { return static_cast<int>(s.source()); })
      .def_prop_ro("origin",
                   [](const Store& s) {
                     const heli::params::Origin& from = s.origin();
                     const std::uint64_t low = from.fresh[0] | std::uint64_t{from.fresh[1]} << 32U;
                     const auto high = nb::int_(from.fresh[2]).attr("__lshift__")(64);
                     return nb::make_tuple(from.kept, from.dropped, high.attr("__or__")(low));
                   })
      .def_prop_ro("generation", &Store::generation);
}

void bind_harness(nb::module_& m) {
  nb::class_<LinkHarness>(m, "Harness")
      .def(nb::init<std::int16_t, std::size_t>(), "duty_full"_a, "page_bytes"_a)
      .def_ro("board", &LinkHarness::board)
      .def_ro("params", &LinkHarness::params)
      .def_ro("store", &LinkHarness::store)
      .def(
          "receive",
          [](LinkHarness& h, const nb::bytes& data) {
            h.board.received.insert(h.board.received.end(), data_of(data),
                                    data_of(data) + data.size());
          },
          "data"_a, "Bytes that the next poll will find.")
      .def("poll", [](LinkHarness& h) { h.link.poll(); })
      .def(
          "sent",
          [](LinkHarness& h) {
            const Bytes all = std::exchange(h.board.sent, {});
            return to_python(all);
          },
          "Bytes transmitted since the last call.")
      .def_prop_rw(
          "room", [](const LinkHarness& h) { return h.board.room; },
          [](LinkHarness& h, std::size_t room) { h.board.room = room; },
          "Bytes that the transmitter still takes.")
      .def("begin_tick", [](LinkHarness& h, std::uint32_t tick) { h.link.begin_tick(tick); })
      .def("take_request", &take_request, "(message id, payload) or None.")
      .def(
          "answer",
          [](LinkHarness& h, int result, std::uint8_t detail, float value) {
            h.link.answer({static_cast<heli::link::Result>(result), detail, value});
          },
          "result"_a = 0, "detail"_a = 0, "value"_a = 0.0F)
      .def("take_stream", &take_stream, "(message id, payload) or None.")
      .def(
          "push_samples",
          [](LinkHarness& h, std::uint32_t first_tick, const RawTicks& raw) {
            for (const Sample& sample : samples_of(first_tick, raw)) {
              Sample& room = h.link.next_sample();
              room = sample;
              h.link.commit_sample(room);
            }
          },
          "first_tick"_a, "raw"_a)
      .def(
          "push_event",
          [](LinkHarness& h, std::uint32_t tick, std::uint8_t kind) {
            h.link.push_event({tick, kind, 0, 0, 0.0F});
          },
          "tick"_a, "kind"_a)
      .def(
          "publish",
          [](LinkHarness& h, std::uint32_t overruns) {
            heli::link::TickCounters counters;
            counters.overruns = overruns;
            h.link.publish(counters);
          },
          "overruns"_a)
      .def("ticks_since_host_frame",
           [](const LinkHarness& h) { return h.link.ticks_since_host_frame(); });
}

}  // namespace

void bind_link(nb::module_& module) {
  nb::module_ m = module.def_submodule("link", "The board's end of the link.");
  bind_codec(m);
  bind_params(m);
  bind_harness(m);
}
