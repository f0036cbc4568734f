import pathlib
def edit(path,pairs):
    p=pathlib.Path(path); t=p.read_text()
    for a,b in pairs:
        if t.count(a)!=1: print('MISS',path,t.count(a),repr(a[:90])); continue
        t=t.replace(a,b)
    p.write_text(t)
edit('docs/design.md',[
("the original's number and sequence number. A latched ghost keeps its original's own history. A ghost outlives its original by 5 s,\nbecause samples may still be on their way. The plan's","the original's number and sequence number. A ghost outlives its original by 5 s, because samples may still be on their way. The plan's"),
("the link is out. Then nothing leaves but a probe every 0.1 s and\nsigns of life, and what","the link is out. Then nothing leaves but signs of life and a\nprobe every 0.1 s, after half a minute every second, and what"),
])
edit('docs/operating.md',[
("that needs a restart keeps its old value until then; the status and `arpd_config_keys_awaiting_restart` name it.","that needs a restart keeps its old value until then; the status names it, and `arpd_config_keys_awaiting_restart` counts such keys."),
])
edit('docs/security.md',[
("Each writer has its own rate limit and quota, so a flood takes nothing from the others\n(`tests/unit/ros/test_inbox.py`). Refused","Each writer has its own rate limit, so a flood takes nothing from the others (`tests/unit/ros/test_inbox.py`). Refused"),
])
p=pathlib.Path('arpd/README.md'); L=p.read_text().split('\n')
i=L.index('| word | meaning |')+2; j=i
while L[j].startswith('|'): j+=1
L[i:j]=sorted(L[i:j],key=lambda r:r.lower())
p.write_text('\n'.join(L))
