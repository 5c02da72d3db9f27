-- Murmur's radio for Wireshark and tshark: every packet by name and field (docs/capture.md).
--
-- This file is a template: the installer (deploy/after/wireshark/install.py) replaces TABLES below by the names and
-- layouts that the program itself uses. Nothing here may fail on malformed bytes: they become an expert info, and the
-- rest of the frame is shown as raw bytes.

local murmur = Proto("murmur", "Murmur radio")

-- FRAMES, VERDICTS: names by number. Verdicts from FIRST_ON_AIR on are of frames that were sent but not received.
-- LAYOUTS: packet class, kind, code as binary digits, bytes before the content, fields as
-- {name, bits, bias}, content as {least bytes, most bytes}.
-- FIELDS: names, types and labels of all fields of packets.
@TABLES@

-- For each version of the header: bytes of a robot's number, of the mask of receivers, and of the whole header.
local HEADS = { [1] = { number = 1, mask = 8, size = 24 }, [2] = { number = 2, mask = 32, size = 52 } }

local f = {
  version = ProtoField.uint8("murmur.version", "Version of this header"),
  frame = ProtoField.uint8("murmur.frame", "Frame", base.DEC, FRAMES),
  verdict = ProtoField.uint8("murmur.verdict", "Verdict", base.DEC, VERDICTS),
  round = ProtoField.uint8("murmur.round", "Round"),
  sender = ProtoField.int16("murmur.sender", "Sender"),
  receiver = ProtoField.int16("murmur.receiver", "Receiver"),
  map = ProtoField.int16("murmur.map", "Map"),
  part = ProtoField.uint16("murmur.part", "Part"),
  step = ProtoField.uint32("murmur.step", "Step"),
  connection = ProtoField.int32("murmur.connection", "Connection"),
  receivers = ProtoField.bytes("murmur.receivers", "Received by"),
  received_by = ProtoField.uint8("murmur.received_by", "Received by robot"),
  bytes = ProtoField.uint32("murmur.bytes", "Bytes of the frame"),
  truncated = ProtoField.uint32("murmur.truncated", "Bytes that the capture left out"),
  packet = ProtoField.string("murmur.packet", "Packet"),
  kind = ProtoField.string("murmur.kind", "Kind"),
  size = ProtoField.uint16("murmur.size", "Size"),
  data = ProtoField.bytes("murmur.data", "Content"),
  rest = ProtoField.bytes("murmur.rest", "Malformed bytes"),
}
for _, field in ipairs(FIELDS) do
  f[field[1]] = f[field[1]] or ProtoField[field[2]]("murmur." .. field[1], field[3])
end
local list = {}
for _, field in pairs(f) do
  list[#list + 1] = field
end
murmur.fields = list

local broken = ProtoExpert.new("murmur.broken", "Not a packet", expert.group.MALFORMED, expert.severity.ERROR)
local spare = ProtoExpert.new("murmur.spare", "Bits set that must be zero", expert.group.PROTOCOL, expert.severity.WARN)
local refused = ProtoExpert.new("murmur.refused", "Not delivered", expert.group.RESPONSE_CODE, expert.severity.NOTE)
murmur.experts = { broken, spare, refused }

local function robot(number)
  if number == -1 then
    return "all"
  end
  return number < 0 and "unknown" or "r" .. number
end

-- The layout of packets that start with a byte, or nil.
local function layout_of(first)
  for _, layout in ipairs(LAYOUTS) do
    local known = math.min(#layout.code, 8)
    if math.floor(first / 2 ^ (8 - known)) == tonumber(layout.code:sub(1, known), 2) then
      return layout
    end
  end
  return nil
end

-- Add the fields of a packet to its item; return their text, and the number of bits read.
local function show_fields(item, range, layout)
  local at, texts = #layout.code, {}
  for _, field in ipairs(layout.fields) do
    local name, width, bias = field[1], field[2], field[3]
    if name ~= "length" then
      local value = range:bitfield(at, width) - bias
      local first, last = math.floor(at / 8), math.floor((at + width - 1) / 8)
      item:add(f[name], range(first, last - first + 1), value)
      texts[#texts + 1] = name .. " " .. value
    end
    at = at + width
  end
  return texts, at
end

-- The bytes before the content, and of the content, of the packet at an offset; or nil and an error text.
local function sizes(tvb, offset, layout)
  if not layout.content then
    return layout.size, 0
  end
  local least, most = layout.content[1], layout.content[2]
  local length = layout.fields[1]
  if not length then
    return layout.size, most
  end
  if tvb:len() - offset < layout.size then
    return layout.size, least
  end
  local size = tvb(offset, layout.size):bitfield(#layout.code, length[2]) - length[3]
  if size < least or size > most then
    return nil, "a packet of kind " .. layout.kind .. " with " .. size .. " bytes of content"
  end
  return layout.size, size
end

-- Show the packet at an offset; return its kind and size, or nil, an error text, and how many bytes it needs.
local function show_packet(tree, tvb, offset)
  local layout = layout_of(tvb(offset, 1):uint())
  if not layout then
    return nil, "no packet begins like this", 0
  end
  local head, content = sizes(tvb, offset, layout)
  if not head then
    return nil, content, 0
  end
  if head + content > tvb:len() - offset then
    return nil, "a packet of kind " .. layout.kind .. ", cut off", head + content
  end
  local range = tvb(offset, head + content)
  if range:bitfield(0, #layout.code) ~= tonumber(layout.code, 2) then
    return nil, "no packet begins like this", 0
  end
  local item = tree:add(f.packet, range, layout.name)
  item:add(f.kind, range, layout.kind)
  item:add(f.size, range, head + content)
  local texts, at = show_fields(item, range, layout)
  if layout.content then
    if content > 0 then
      item:add(f.data, tvb(offset + head, content))
    end
    texts[#texts + 1] = content .. " bytes"
  end
  item:set_text(layout.kind .. " (" .. layout.name .. ") " .. table.concat(texts, ", "))
  local left = 8 * head - at
  if not layout.content and left > 0 and range:bitfield(at, left) ~= 0 then
    item:add_proto_expert_info(spare, "the last " .. left .. " bits must be zero")
  end
  return layout.kind, head + content
end

-- Show all packets of a frame, behind the header; return their numbers by kind, as "12 ins, 1 save".
local function show_packets(tree, tvb, begin)
  local offset, truncated = begin, tvb:reported_len() - tvb:len()
  local counts, kinds = {}, {}
  while offset < tvb:len() do
    local kind, size, needed = show_packet(tree, tvb, offset)
    if not kind then
      local have = tvb:len() - offset
      local item = tree:add(f.rest, tvb(offset))
      if truncated == 0 or needed <= have then
        item:add_proto_expert_info(broken, size .. ", at byte " .. (offset - begin))
        kinds[#kinds + 1] = "broken"
      end
      break
    end
    if not counts[kind] then
      counts[kind] = 0
      kinds[#kinds + 1] = kind
    end
    counts[kind] = counts[kind] + 1
    offset = offset + size
  end
  if truncated > 0 then
    tree:add(f.truncated, tvb(0, 0), truncated):set_generated()
  end
  local texts = {}
  for _, kind in ipairs(kinds) do
    texts[#texts + 1] = counts[kind] and counts[kind] .. " " .. kind or kind
  end
  if truncated > 0 then
    texts[#texts + 1] = "..."
  end
  return table.concat(texts, ", ")
end

local function show_receivers(tree, mask)
  local item, names = tree:add(f.receivers, mask), {}
  for number = 0, 8 * mask:len() - 1 do
    local byte = mask(mask:len() - 1 - math.floor(number / 8), 1)
    if byte:bitfield(7 - number % 8, 1) == 1 then
      item:add(f.received_by, byte, number):set_generated()
      names[#names + 1] = "r" .. number
    end
  end
  item:set_text("Received by: " .. (#names > 0 and table.concat(names, ", ") or "none"))
end

function murmur.dissector(tvb, pinfo, root)
  pinfo.cols.protocol = "MURMUR"
  local tree = root:add(murmur, tvb())
  local head = tvb:len() > 0 and HEADS[tvb(0, 1):uint()]
  if not head or tvb:len() < head.size then
    tree:add_proto_expert_info(broken, "no header of version 1 or 2: another program's capture, or a newer one")
    pinfo.cols.info = "no header of version 1 or 2"
    return tvb:len()
  end
  local function numbered(place)
    return tvb(4 + place * head.number, head.number)
  end
  local rest = 4 + 4 * head.number
  local frame, verdict, step = tvb(1, 1):uint(), tvb(2, 1):uint(), tvb(rest, 4)
  local from, to, map = robot(numbered(0):int()), robot(numbered(1):int()), numbered(2):int()
  local outcome = VERDICTS[verdict] or "verdict " .. verdict
  tree:add(f.version, tvb(0, 1))
  tree:add(f.frame, tvb(1, 1))
  local result = tree:add(f.verdict, tvb(2, 1))
  if verdict ~= 0 then
    result:add_proto_expert_info(refused, (verdict < FIRST_ON_AIR and "not sent: " or "not received: ") .. outcome)
  end
  tree:add(f.step, step)
  tree:add(f.round, tvb(3, 1))
  tree:add(f.connection, tvb(rest + 4, 4))
  tree:add(f.sender, numbered(0)):append_text(" (" .. from .. ")")
  tree:add(f.receiver, numbered(1)):append_text(" (" .. to .. ")")
  tree:add(f.map, numbered(2))
  tree:add(f.part, numbered(3))
  show_receivers(tree, tvb(rest + 8, head.mask))
  local size = tvb:reported_len() - head.size
  tree:add(f.bytes, tvb(0, 0), size):set_generated()
  local packets = show_packets(tree, tvb, head.size)
  local name = (FRAMES[frame] or "frame " .. frame) .. (map >= 0 and " of map " .. map or "")
  tree:set_text("Murmur radio, step " .. step:uint() .. ": " .. from .. " to " .. to .. ", " .. name .. ", " .. outcome)
  pinfo.cols.src, pinfo.cols.dst = from, to
  pinfo.cols.info = name .. ": " .. packets .. " (" .. size .. " bytes), " .. outcome
  return tvb:len()
end

DissectorTable.get("wtap_encap"):add((wtap_encaps or wtap).USER0, murmur)
