-- Murmur's radio for Wireshark and tshark: every packet by name and field (docs/capture.md).
--
-- The layouts repeat protocol/packets.py, and the header netshaper/capture.py. Nothing here may fail on malformed
-- bytes: they become an expert info, and the rest of the frame is shown as raw bytes.

local murmur = Proto("murmur", "Murmur radio")

local FRAMES = { [0] = "offer", [1] = "answer", [2] = "data", [3] = "broadcast", [4] = "news" }
local VERDICTS = { [0] = "carried", [1] = "budget", [2] = "range", [3] = "protocol", [4] = "lost", [5] = "mute",
  [6] = "limit", [7] = "loss", [8] = "damaged", [9] = "full" }
-- From here on a verdict says why nobody heard what was on the air.
local FIRST_ON_AIR = 7
local FULL_SCAN, SHORT_SCAN, SCAN = 0xF1, 0xF2, 63
local LOOK, LAST_LOOK, LOOK_DATA = 0xF4, 0xF5, 8

-- Of each version of the head: bytes of a robot's number, of the mask of those who heard it, and of all.
local HEADS = { [1] = { number = 1, mask = 8, size = 24 }, [2] = { number = 2, mask = 32, size = 52 } }

-- Each packet: kind, name of its layout, bytes, code, bits of the code, and its fields in order as
-- {name, bits} or {name, bits, what is added on the air}.
local VERTEX = { { "index", 12 }, { "x", 12, 1 }, { "y", 12, 1 }, { "side", 2 }, { "occupied", 1 } }
local OBJECT = { { "object", 12 }, { "count", 13 }, { "inside", 1 } }
local LAYOUTS = {
  { kind = "targ", name = "Target", size = 3, code = 0, bits = 2, fields = { { "x", 11 }, { "y", 11 } } },
  { kind = "ins", name = "Insert", size = 6, code = 2, bits = 3, fields = VERTEX },
  { kind = "rep", name = "Replace", size = 6, code = 3, bits = 3, fields = VERTEX },
  { kind = "del", name = "Delete", size = 2, code = 4, bits = 3, fields = { { "index", 12 } } },
  { kind = "rm", name = "Remove", size = 2, code = 10, bits = 4, fields = { { "object", 12 } } },
  { kind = "conn", name = "Answer", size = 2, code = 11, bits = 4, fields = { { "index", 12 } } },
  { kind = "conn", name = "Offer", size = 2, code = 12, bits = 4, fields = { { "map", 6 }, { "block", 6 } } },
  { kind = "em", name = "Emerge", size = 5, code = 13, bits = 4, fields = OBJECT },
  { kind = "chg", name = "Change", size = 5, code = 14, bits = 4, fields = OBJECT },
  { kind = "save", name = "Save", size = 1, code = 0xF0, bits = 8, fields = {} },
  { kind = "pose", name = "Pose", size = 4, code = 0xF3, bits = 8, fields = { { "x", 11 }, { "y", 11 }, { "leads", 1 } } },
  { kind = "pose", name = "Passed", size = 6, code = 0xFF0, bits = 12, fields = { { "robot", 8 }, { "age", 6 },
    { "x", 11 }, { "y", 11 } } },
  { kind = "conn", name = "Block", size = 2, code = 0x3E0, bits = 10, fields = { { "block", 6 } } },
  { kind = "conn", name = "Decline", size = 2, code = 0xFC00, bits = 16, fields = {} },
  { kind = "conn", name = "From", size = 5, code = 0xF6, bits = 8, fields = { { "map", 8 }, { "index", 24 } } },
  { kind = "conn", name = "FromEarly", size = 3, code = 0xFB, bits = 8, fields = { { "map", 8 }, { "index", 8 } } },
  { kind = "conn", name = "Held", size = 5, code = 0xF7, bits = 8, fields = { { "map", 8 }, { "index", 24 } } },
  { kind = "conn", name = "HeldEarly", size = 3, code = 0xFD, bits = 8, fields = { { "map", 8 }, { "index", 8 } } },
  { kind = "conn", name = "Near", size = 2, code = 0xF9, bits = 8, fields = { { "robot", 8 } } },
  { kind = "conn", name = "Gone", size = 2, code = 0xFE, bits = 8, fields = { { "robot", 8 } } },
  { kind = "sum", name = "Check", size = 3, code = 0xFA, bits = 8, fields = { { "sum", 16 } } },
}

local f = {
  version = ProtoField.uint8("murmur.version", "Version of this head"),
  frame = ProtoField.uint8("murmur.frame", "Frame", base.DEC, FRAMES),
  verdict = ProtoField.uint8("murmur.verdict", "Verdict", base.DEC, VERDICTS),
  exchange = ProtoField.uint8("murmur.exchange", "Exchange"),
  sender = ProtoField.int16("murmur.sender", "Sender"),
  receiver = ProtoField.int16("murmur.receiver", "Receiver"),
  map = ProtoField.int16("murmur.map", "Map"),
  part = ProtoField.uint16("murmur.part", "Part"),
  step = ProtoField.uint32("murmur.step", "Step"),
  connection = ProtoField.int32("murmur.connection", "Connection"),
  hearers = ProtoField.bytes("murmur.hearers", "Heard by"),
  hearer = ProtoField.uint8("murmur.hearer", "Heard by robot"),
  bytes = ProtoField.uint32("murmur.bytes", "Bytes said"),
  unkept = ProtoField.uint32("murmur.unkept", "Bytes said that were not kept"),
  packet = ProtoField.string("murmur.packet", "Packet"),
  kind = ProtoField.string("murmur.kind", "Kind"),
  size = ProtoField.uint16("murmur.size", "Size"),
  index = ProtoField.uint32("murmur.index", "Index"),
  x = ProtoField.int16("murmur.x", "Cell x"),
  y = ProtoField.int16("murmur.y", "Cell y"),
  side = ProtoField.uint8("murmur.side", "Side of the cell"),
  occupied = ProtoField.uint8("murmur.occupied", "Edge is occupied"),
  object = ProtoField.uint16("murmur.object", "Object"),
  count = ProtoField.uint16("murmur.count", "Vertices"),
  inside = ProtoField.uint8("murmur.inside", "Encloses free space"),
  block = ProtoField.uint8("murmur.block", "Block"),
  leads = ProtoField.uint8("murmur.leads", "Sender leads"),
  robot = ProtoField.uint8("murmur.robot", "Robot"),
  age = ProtoField.uint8("murmur.age", "Steps ago"),
  sum = ProtoField.uint16("murmur.sum", "Checksum"),
  number = ProtoField.uint8("murmur.number", "Unit, modulo 4"),
  data = ProtoField.bytes("murmur.data", "Piece of a scan, or of a unit of looks"),
  rest = ProtoField.bytes("murmur.rest", "Bytes that are no packet"),
}
local list = {}
for _, field in pairs(f) do
  list[#list + 1] = field
end
murmur.fields = list

local broken = ProtoExpert.new("murmur.broken", "Not a packet", expert.group.MALFORMED, expert.severity.ERROR)
local spare = ProtoExpert.new("murmur.spare", "Bits set that must be zero", expert.group.PROTOCOL, expert.severity.WARN)
local refused = ProtoExpert.new("murmur.refused", "Not carried", expert.group.RESPONSE_CODE, expert.severity.NOTE)
murmur.experts = { broken, spare, refused }

local function robot(number)
  if number == -1 then
    return "all"
  end
  return number < 0 and "nobody" or "r" .. number
end

-- The layout that a first byte announces, or nil.
local function announced(first)
  for _, layout in ipairs(LAYOUTS) do
    local known = math.min(layout.bits, 8)
    if math.floor(first / 2 ^ (8 - known)) == math.floor(layout.code / 2 ^ (layout.bits - known)) then
      return layout
    end
  end
  return nil
end

-- Show a packet of bits; return nothing, or what is wrong with it.
local function show_bits(tree, range, layout)
  if range:bitfield(0, layout.bits) ~= layout.code then
    return "no packet begins like this"
  end
  local item = tree:add(f.packet, range, layout.name)
  item:add(f.kind, range, layout.kind)
  item:add(f.size, range, layout.size)
  local at, words = layout.bits, {}
  for _, field in ipairs(layout.fields) do
    local name, width, added = field[1], field[2], field[3] or 0
    local value = range:bitfield(at, width) - added
    local first, last = math.floor(at / 8), math.floor((at + width - 1) / 8)
    item:add(f[name], range(first, last - first + 1), value)
    words[#words + 1] = name .. " " .. value
    at = at + width
  end
  item:set_text(layout.kind .. " (" .. layout.name .. ") " .. table.concat(words, ", "))
  local left = 8 * layout.size - at
  if left > 0 and range:bitfield(at, left) ~= 0 then
    item:add_proto_expert_info(spare, "the last " .. left .. " bits must be zero")
  end
  return nil
end

local function show_scan(tree, range, data)
  local item = tree:add(f.packet, range, "Fragment")
  item:add(f.kind, range, "scan")
  item:add(f.size, range, range:len())
  item:add(f.data, data)
  item:set_text("scan (Fragment) " .. data:len() .. " bytes")
end

local function show_look(tree, range, data, number)
  local item = tree:add(f.packet, range, "Look")
  item:add(f.kind, range, "look")
  item:add(f.size, range, range:len())
  local words = "look (Look) "
  if number then
    item:add(f.number, range(1, 1), number)
    words = words .. "number " .. number .. ", "
  end
  if data then
    item:add(f.data, data)
  end
  item:set_text(words .. (data and data:len() or 0) .. " bytes")
end

-- Show the packet at an offset; return its kind and size, or nil, what is wrong, and how many bytes it wants.
local function show_packet(tree, tvb, offset)
  local first, have = tvb(offset, 1):uint(), tvb:len() - offset
  if first == FULL_SCAN or first == SHORT_SCAN then
    local head, size = 1, SCAN
    if first == SHORT_SCAN then
      head, size = 2, have > 1 and tvb(offset + 1, 1):uint() or 1
      if have > 1 and (size < 1 or size >= SCAN) then
        return nil, "a short fragment of " .. size .. " bytes", 0
      end
    end
    if head + size > have then
      return nil, "a scan fragment, cut off", head + size
    end
    show_scan(tree, tvb(offset, head + size), tvb(offset + head, size))
    return "scan", head + size
  end
  if first == LOOK or first == LAST_LOOK then
    local head, size, number = 1, LOOK_DATA, nil
    if first == LAST_LOOK then
      local second = have > 1 and tvb(offset + 1, 1):uint() or 0
      head, size, number = 2, math.floor(second / 4), second % 4
    end
    if head + size > have then
      return nil, "a piece of a unit of looks, cut off", head + size
    end
    show_look(tree, tvb(offset, head + size), size > 0 and tvb(offset + head, size) or nil, number)
    return "look", head + size
  end
  local layout = announced(first)
  if not layout then
    return nil, "no packet begins like this", 0
  end
  if layout.size > have then
    return nil, "a packet of kind " .. layout.kind .. ", cut off", layout.size
  end
  local wrong = show_bits(tree, tvb(offset, layout.size), layout)
  if wrong then
    return nil, wrong, 0
  end
  return layout.kind, layout.size
end

-- Show all packets of a frame, which begins after a head; return them counted, as "12 ins, 1 save".
local function show_packets(tree, tvb, begin)
  local offset, unkept = begin, tvb:reported_len() - tvb:len()
  local counts, kinds = {}, {}
  while offset < tvb:len() do
    local kind, size, wanted = show_packet(tree, tvb, offset)
    if not kind then
      local have = tvb:len() - offset
      local item = tree:add(f.rest, tvb(offset))
      if unkept == 0 or wanted <= have then
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
  if unkept > 0 then
    tree:add(f.unkept, tvb(0, 0), unkept):set_generated()
  end
  local words = {}
  for _, kind in ipairs(kinds) do
    words[#words + 1] = counts[kind] and counts[kind] .. " " .. kind or kind
  end
  if unkept > 0 then
    words[#words + 1] = "..."
  end
  return table.concat(words, ", ")
end

local function show_hearers(tree, mask)
  local item, names = tree:add(f.hearers, mask), {}
  for number = 0, 8 * mask:len() - 1 do
    local byte = mask(mask:len() - 1 - math.floor(number / 8), 1)
    if byte:bitfield(7 - number % 8, 1) == 1 then
      item:add(f.hearer, byte, number):set_generated()
      names[#names + 1] = "r" .. number
    end
  end
  item:set_text("Heard by: " .. (#names > 0 and table.concat(names, ", ") or "nobody"))
end

function murmur.dissector(tvb, pinfo, root)
  pinfo.cols.protocol = "MURMUR"
  local tree = root:add(murmur, tvb())
  local head = tvb:len() > 0 and HEADS[tvb(0, 1):uint()]
  if not head or tvb:len() < head.size then
    tree:add_proto_expert_info(broken, "no head of version 1 or 2: another program's capture, or a newer one")
    pinfo.cols.info = "no head of version 1 or 2"
    return tvb:len()
  end
  local function numbered(place)
    return tvb(4 + place * head.number, head.number)
  end
  local rest = 4 + 4 * head.number
  local frame, verdict, step = tvb(1, 1):uint(), tvb(2, 1):uint(), tvb(rest, 4)
  local from, to, about = robot(numbered(0):int()), robot(numbered(1):int()), numbered(2):int()
  tree:add(f.version, tvb(0, 1))
  tree:add(f.frame, tvb(1, 1))
  local result = tree:add(f.verdict, tvb(2, 1))
  if verdict ~= 0 then
    result:add_proto_expert_info(refused, (verdict < FIRST_ON_AIR and "not carried: " or "not heard: ") .. (VERDICTS[verdict] or "?"))
  end
  tree:add(f.step, step)
  tree:add(f.exchange, tvb(3, 1))
  tree:add(f.connection, tvb(rest + 4, 4))
  tree:add(f.sender, numbered(0)):append_text(" (" .. from .. ")")
  tree:add(f.receiver, numbered(1)):append_text(" (" .. to .. ")")
  tree:add(f.map, numbered(2))
  tree:add(f.part, numbered(3))
  show_hearers(tree, tvb(rest + 8, head.mask))
  local said = tvb:reported_len() - head.size
  tree:add(f.bytes, tvb(0, 0), said):set_generated()
  local packets = show_packets(tree, tvb, head.size)
  local what = (FRAMES[frame] or "frame " .. frame) .. (about >= 0 and " of map " .. about or "")
  local outcome = VERDICTS[verdict] or "verdict " .. verdict
  tree:set_text("Murmur radio, step " .. step:uint() .. ": " .. from .. " to " .. to .. ", " .. what .. ", " .. outcome)
  pinfo.cols.src, pinfo.cols.dst = from, to
  pinfo.cols.info = what .. ": " .. packets .. " (" .. said .. " bytes), " .. outcome
  return tvb:len()
end

DissectorTable.get("wtap_encap"):add((wtap_encaps or wtap).USER0, murmur)
